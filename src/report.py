"""Tables and figures from outputs/, ours beside the paper's numbers: python src/report.py"""

import io
import logging
from functools import lru_cache
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from cophy import cli, config
from cophy.files import write_atomically

config.register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path="../conf", config_name="report")
def main(cfg: DictConfig) -> None:
    from cophy.report import difficulty, figures, render  # matplotlib takes a second to import; --help does not need it
    from cophy.report.runs import read_runs, summary
    from cophy.report.tables import fill, paper_tables

    settings: config.ReportConfig = cli.to_config(cfg)
    runs = read_runs(Path(settings.outputs), lambda names: configuration_of(names, settings.source.name))
    directory = Path(settings.directory)
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    filled = [fill(table, runs) for table in paper_tables()]
    drawn = {}
    for result in filled:
        if result.values[["seeds", "failed"]].to_numpy().any():
            render.show(result.table.title, render.for_terminal(result), result.caption)
            if (shares := result.shares()) is not None:
                render.show(render.SHARE, shares.reset_index(names=""), "")
            drawn[f"table-{result.table.id}"] = figures.draw_bars(result)
        else:
            log.info("%s: nothing was run yet", result.table.title)
        write_atomically(directory / f"{result.table.id}.csv", result.values.to_csv(index=False).encode())
    everything = summary(runs)
    if len(everything):
        main = [name for name in ("run", "seeds", "training (s)", "mse", "final position error") if name in everything]
        caption = "Mean over seeds, ± standard deviation where there are several. All metrics: tables.md, runs.csv."
        render.show("Everything that was run", everything[main], caption)
    written = {
        "tables.md": "\n".join(map(render.markdown, filled))
        + f"\n## Everything that was run\n\n{everything.to_markdown(index=False)}\n",
        "tables.tex": "\n".join(map(render.latex, filled)),
        "runs.csv": runs.to_csv(index=False),
    }
    for name, text in written.items():
        write_atomically(directory / name, text.encode())
    finished = runs[runs["error"].isna()] if len(runs) else runs
    if len(finished):
        scenarios = {
            name: cli.to_config(composed("train", f"source={settings.source.name}", f"scenario={name}")).scenario
            for name in finished["scenario"].unique()
        }
        drawn |= dict(figures.of_predictions(finished, scenarios))
        if settings.source.is_generated:  # twins, margins and balance are those of generated data
            drawn |= stability_distribution(finished, settings)
            broken_down = by_difficulty(finished, settings, scenarios)
            if len(broken_down):
                write_atomically(directory / "difficulty.csv", broken_down.to_csv(index=False).encode())
                write_atomically(directory / "difficulty.md", difficulty.page(broken_down).encode())
                drawn |= dict(difficulty.draw(broken_down))
    for name, figure in drawn.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=110)
        write_atomically(directory / "figures" / f"{name}.png", picture.getvalue())
    log.info("%d runs; tables (md, tex, csv) and %d figures in %s", len(runs), len(drawn), directory)


def composed(name: str, *overrides: str) -> DictConfig:
    """A configuration as the command line composes it, rows of a `hydra.searchpath=` given to the report included."""
    paths = [override for override in HydraConfig.get().overrides.hydra if override.startswith("hydra.searchpath=")]
    return hydra.compose(name, [*paths, *overrides])


def configuration_of(names: dict[str, Any], source: str) -> dict[str, Any]:
    """What the names of a run stand for on data of this source: the keys that make it the row it claims to be."""
    groups = (f"{group}={names[group]}" for group in ("scenario", "split", "model", "ablation"))
    cfg = composed("train", f"source={source}", *groups)
    plain: Any = OmegaConf.to_container(cfg, resolve=True, enum_to_str=True)
    keys = ("model", "scenario", "split", "training", "data_seed")
    of_pictures = ("render", "num_frames", "num_objects") if names["model"].startswith("derenderer") else ()
    return {key: plain[key] for key in (*keys, *of_pictures)}


def by_difficulty(runs: Any, settings: config.ReportConfig, scenarios: dict[str, Any]) -> Any:
    """MSE by difficulty on the default split of each scenario, where its dataset lies in `data_dir`; a line per number."""
    from pandas import DataFrame, concat

    from cophy.report.difficulty import breakdown

    default = {name: scenario.task.splits[0] for name, scenario in scenarios.items()}
    predictors = runs[(runs["split"] == runs["scenario"].map(default)) & ~runs["model"].str.startswith("derenderer")]
    frames = []
    for (name, split, size), found in predictors.groupby(["scenario", "split", "size"]):
        part = cli.to_config(composed("train", f"scenario={name}", f"split={split}")).split.test
        arrays = load(name, part.num_objects, size, settings.data_dir)
        if arrays is not None:
            frames.append(breakdown(found, arrays, spec_of(name, part.num_objects, size), part))
    return concat(frames) if frames else DataFrame()


def stability_distribution(runs: Any, settings: config.ReportConfig) -> dict[str, Any]:
    """The figure of that name, from the tower datasets that the runs used, where they lie in `data_dir`."""
    from cophy.report.figures import draw_stability_distribution

    towers = runs[runs["scenario"] == "blocktower"]
    drawn = {}
    for size in towers["size"].unique():
        arrays, stands = {}, {}
        for count in (3, 4):
            spec = spec_of("blocktower", count, size)
            if spec.id not in set(towers["dataset_ids"].explode()):
                continue
            loaded = load("blocktower", count, size, settings.data_dir)
            if loaded is not None:
                arrays[count] = loaded
                standing = [stratum.endswith("stands") for stratum in spec.scenario.strata()]
                stands[count] = [standing[stratum] for stratum in loaded["stratum"]]
        if arrays:
            drawn[f"stability_distribution-{size}"] = draw_stability_distribution(arrays, stands)
    return drawn


def spec_of(scenario: str, num_objects: int, size: str) -> Any:
    """The dataset that runs of this scenario and size use."""
    from cophy.dataset.spec import DatasetSpec

    chosen = cli.to_config(composed("generate", f"scenario={scenario}", f"size={size}"))
    return DatasetSpec(chosen.scenario, num_objects, chosen.size, chosen.seed)


@lru_cache(maxsize=2)  # large, and towers of three are looked at twice
def load(scenario: str, num_objects: int, size: str, data_dir: str) -> dict[str, Any] | None:
    """The arrays of that dataset; where it is not there, the log says so."""
    from cophy.dataset.states import States

    states = States(spec_of(scenario, num_objects, size), Path(data_dir))
    if states.is_finished():
        return states.load()
    log.info("%s is not there: the report does without what only the dataset tells", states.directory)
    return None


if __name__ == "__main__":
    cli.run(main)
