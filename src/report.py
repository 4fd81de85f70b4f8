"""Tables from outputs/, ours beside the paper's numbers: python src/report.py"""

import logging
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from cophy import cli, config

config.register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path="../conf", config_name="report")
def main(cfg: DictConfig) -> None:
    from cophy.dataset.store import write_atomically  # pandas takes a second to import; --help does not need it
    from cophy.report.runs import read_runs
    from cophy.report.tables import fill, paper_tables

    settings: config.ReportConfig = cli.to_config(cfg)
    runs = read_runs(Path(settings.outputs), model_of)
    directory = Path(settings.directory)
    directory.mkdir(parents=True, exist_ok=True)
    filled = [fill(table, runs) for table in paper_tables()]
    for result in filled:
        show(result)
        write_atomically(directory / f"{result.table.id}.csv", result.values.to_csv(index=False).encode())
    markdown = "\n".join(f"## {r.table.title}\n\n{r.cells.to_markdown()}\n\n{r.caption}\n" for r in filled)
    write_atomically(directory / "tables.md", markdown.encode())
    log.info("%d runs; tables in %s", len(runs), directory)


def model_of(names: dict[str, Any]) -> dict[str, Any]:
    """The model configuration that the names of a run stand for."""
    overrides = [f"{group}={names[group]}" for group in ("scenario", "split", "model", "ablation")]
    model = hydra.compose("train", overrides).model
    return {str(key): value for key, value in OmegaConf.to_container(model, resolve=True, enum_to_str=True).items()}  # type: ignore[union-attr]


def show(result: Any) -> None:
    """Print a filled table."""
    table = Table(title=result.table.title, caption=result.caption, title_justify="left", caption_justify="left")
    table.add_column(result.cells.index.name)
    for column in result.cells.columns:
        table.add_column(column, justify="right")
    for label, row in result.cells.iterrows():
        table.add_row(str(label), *row)
    Console().print(table)


if __name__ == "__main__":
    cli.run(main)
