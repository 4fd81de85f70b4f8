"""Figures of runs and tables: predictions, error over time, tables as bars."""

from collections.abc import Iterable, Iterator, Mapping
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.drawing.plots import draw_error_over_time, draw_trajectories, error_over_time
from cophy.report.colors import BLUE, GREY, RED
from cophy.report.tables.filled_tables import FilledTable
from cophy.scenario import Scenario
from cophy.training.runs.results import read_predictions

NUM_SHOWN = 4  # experiments: two twin pairs


def of_predictions(runs: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> Iterator[tuple[str, Figure]]:
    """Per scenario and split: the trajectories that CoPhyNet predicts, and every model's error over time."""
    predicted = runs[~runs["model"].str.startswith("derenderer")]
    for keys, found in predicted.groupby(["scenario", "split", "positions"]):
        name, split, positions = (str(key) for key in keys)
        scenario, curves = scenarios[name], {}
        row = f"{name}-{split}" if positions == "ground_truth" else f"{name}-{split}-{positions}"
        for (model, ablation), seeds in found.groupby(["model", "ablation"]):
            each = [read_predictions(directory) for directory in seeds["directory"]]
            dims = scenario.task.metric_dims
            errors = [error_over_time(p["position"], p["target"], p["presence"], dims=dims) for p in each]
            curves[row_name(str(model), str(ablation))] = np.mean(errors, axis=0)
            if (model, ablation) == ("cophynet", "full"):
                shown = [each[0][key][:NUM_SHOWN] for key in ("initial", "position", "target", "presence")]
                yield f"trajectories-{row}", draw_trajectories(*shown, colors=list(scenario.colors.values()))
        ordered = {model: curves[model] for model in in_order(curves)}
        rate, title = scenario.clock.frame_rate_hz, f"{name} {split}, test split"
        yield f"error_over_time-{row}", draw_error_over_time(ordered, frame_rate_hz=rate, title=title)


def row_name(model: str, ablation: str) -> str:
    """What a row of a table is called in figures."""
    return model if ablation == "full" else f"{model} {ablation}"


def in_order(rows: Iterable[str]) -> list[str]:
    """Rows as figures colour them: models, then their ablations, so that a model looks the same wherever all models are."""
    return sorted(rows, key=lambda name: (" " in name, name))


def draw_bars(filled: FilledTable) -> Figure:
    """A table as bars: ours with its interval or standard deviation, the paper's in grey beside it."""
    table, values = filled.table, filled.values
    figure = Figure(figsize=(1.8 + 0.42 * len(values), 4.2), layout="constrained")
    groups, bars = ("column", "row") if table.methods == "rows" else ("row", "column")
    axes = figure.subplots(1, values[groups].nunique(), sharey=True, squeeze=False)[0]
    for axis, (label, group) in zip(axes, values.groupby(groups, sort=False), strict=True):
        at = np.arange(len(group))
        low, high = (
            np.where(group["seeds"] > 1, group["sd"], (group["ours"] - group[end]).abs()) for end in ("low", "high")
        )
        colors = [RED if best else BLUE for best in group["best"]]
        axis.bar(
            at - 0.2, group["ours"].fillna(0), 0.4, color=colors, yerr=np.nan_to_num([low, high]), error_kw={"lw": 0.8}
        )
        axis.bar(at + 0.2, group["paper"].astype(float).fillna(0), 0.4, color=GREY)
        axis.set_xticks(at, group[bars], rotation=60, ha="right", fontsize="small")
        axis.set_title(fill(str(label), 12), fontsize="medium")
        axis.grid(axis="y", alpha=0.2)
    axes[0].set_ylabel(fill(table.title.split(":")[-1].strip(), 50), fontsize="small")
    figure.suptitle(f"{table.title.split(':')[0]}: ours (blue, best red), the paper's (grey)", fontsize="medium")
    return figure
