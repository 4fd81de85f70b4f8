"""Figures of the report: predictions, error over time, tables as bars, and stability per confounder value."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import fill
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.errors import CophyError
from cophy.report.tables import FilledTable
from cophy.training.figures import draw_error_over_time, draw_trajectories, error_over_time
from cophy.training.row import PREDICTIONS

NUM_SHOWN = 4  # experiments: two twin pairs
GREY, BLUE, RED = "#b9bec6", "#2b6fd6", "#d1342f"


def read_predictions(directory: Path) -> dict[str, np.ndarray]:
    """What a run predicted on its test split, beside the truth; a damaged file is an error that names it."""
    path = directory / PREDICTIONS
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in ("initial", "presence", "target", "position")}
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise CophyError(f"{path} is missing or damaged ({error}): run that row again") from error


def of_predictions(runs: pd.DataFrame, scenarios: dict[str, Any]) -> Iterator[tuple[str, Figure]]:
    """Per scenario and split: the trajectories that CoPhyNet predicts, and every model's error over time."""
    predicted = runs[~runs["model"].str.startswith("derenderer")]
    for (name, split, positions), found in predicted.groupby(["scenario", "split", "positions"]):
        scenario, curves = scenarios[str(name)], {}
        row = f"{name}-{split}" if positions == "ground_truth" else f"{name}-{split}-{positions}"
        for (model, ablation), seeds in found.groupby(["model", "ablation"]):
            each = [read_predictions(directory) for directory in seeds["directory"]]
            errors = [
                error_over_time(p["position"], p["target"], p["presence"], dims=scenario.task.metric_dims) for p in each
            ]
            curves[row_name(str(model), str(ablation))] = np.mean(errors, axis=0)
            if (model, ablation) == ("cophynet", "full"):
                shown = [each[0][key][:NUM_SHOWN] for key in ("initial", "position", "target", "presence")]
                yield f"trajectories-{row}", draw_trajectories(*shown, colors=list(scenario.colors.values()))
        ordered = {model: curves[model] for model in in_order(curves)}
        rate = scenario.clock.frame_rate_hz
        yield (
            f"error_over_time-{row}",
            draw_error_over_time(ordered, frame_rate_hz=rate, title=f"{name} {split}, test split"),
        )


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


def draw_stability_distribution(datasets: dict[int, dict[str, np.ndarray]], stands: dict[int, np.ndarray]) -> Figure:
    """Share of towers whose CD stands, for every value of each confounder (the paper's stability distribution).

    datasets: arrays per number of blocks; stands: (experiment,) whether CD stands. Masses and frictions: one
    combination per bar, blocks from the bottom up.
    """
    figure = Figure(figsize=(15, 3.4 * len(datasets)), layout="constrained")
    axes = figure.subplots(len(datasets), 4, squeeze=False, sharey=True, width_ratios=[4, 4, 1, 1])
    for row, (count, arrays) in zip(axes, sorted(datasets.items()), strict=True):
        height = np.where(arrays["presence"][:, 0], arrays["states"][:, 0, 0, :, 2], np.inf)
        blocks = height.argsort(axis=1)[:, :count]
        values = {
            "mass, kg": _combinations(np.take_along_axis(arrays["mass"], blocks, axis=1)),
            "friction": _combinations(np.take_along_axis(arrays["friction"], blocks, axis=1)),
            "gravity x, m/s²": _combinations(arrays["gravity"][:, :1]),
            "gravity y, m/s²": _combinations(arrays["gravity"][:, 1:2]),
        }
        for axis, (name, value) in zip(row, values.items(), strict=True):
            share = 100 * pd.Series(stands[count]).groupby(value).mean()
            at = np.arange(len(share))
            axis.bar(at, share, color=BLUE, label="CD stands")
            axis.bar(at, 100 - share, bottom=share, color=GREY, label="CD falls")
            axis.set_xticks(at, share.index)
            axis.axhspan(45, 55, color="k", alpha=0.12, lw=0)
            axis.set_title(f"{name}, K = {count}" if len(share) > 3 else name, fontsize="medium")
            axis.set_ylim(0, 100)
            axis.tick_params(axis="x", rotation=90 if len(share) > 3 else 0, labelsize="small")
        row[0].set_ylabel("experiments, %")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
    return figure


def _combinations(values: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{value:g}" for value in row) for row in values])
