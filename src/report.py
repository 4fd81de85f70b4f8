"""Tables from outputs/, ours beside the paper's numbers: python src/report.py"""

import logging
from pathlib import Path
from typing import Any

import hydra
import pandas as pd
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from cophy import cli, config
from cophy.dataset.store import write_atomically
from cophy.report.runs import read_runs
from cophy.report.tables import fill, paper_tables, summary

config.register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path="../conf", config_name="report")
def main(cfg: DictConfig) -> None:
    settings: config.ReportConfig = cli.to_config(cfg)
    runs = read_runs(Path(settings.outputs), configuration_of)
    directory = Path(settings.directory)
    directory.mkdir(parents=True, exist_ok=True)
    filled = [fill(table, runs) for table in paper_tables()]
    for result in filled:
        if result.values["ours"].notna().any():
            show(result.table.title, result.cells.reset_index(), result.caption)
        else:
            log.info("%s: nothing was run yet", result.table.title)
        write_atomically(directory / f"{result.table.id}.csv", result.values.to_csv(index=False).encode())
    everything = summary(runs)
    if len(runs):
        show("Everything that was run", everything, "Mean over seeds, ± standard deviation where there are several.")
    markdown = "\n".join(f"## {r.table.title}\n\n{r.cells.to_markdown()}\n\n{r.caption}\n" for r in filled)
    markdown += f"\n## Everything that was run\n\n{everything.to_markdown(index=False)}\n"
    write_atomically(directory / "tables.md", markdown.encode())
    log.info("%d runs; tables in %s", len(runs), directory)


def configuration_of(names: dict[str, Any]) -> dict[str, Any]:
    """Model, scenario and split that the names of a run stand for."""
    config = hydra.compose("train", [f"{group}={names[group]}" for group in ("scenario", "split", "model", "ablation")])
    parts = ("model", "scenario", "split")
    return {part: OmegaConf.to_container(config[part], resolve=True, enum_to_str=True) for part in parts}


def show(title: str, cells: pd.DataFrame, caption: str) -> None:
    """Print a table; the paper's number stands below ours."""
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left")
    for column in cells.columns:
        first = column == cells.columns[0]
        table.add_column(str(column), justify="left" if first else "right", overflow="fold")
    for row in cells.itertuples(index=False):
        table.add_row(*(str(cell).replace(" / ", "\n") for cell in row))
    Console().print(table)


if __name__ == "__main__":
    cli.run(main)
