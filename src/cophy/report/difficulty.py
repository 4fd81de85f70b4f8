"""MSE by difficulty, do-operation and cell: on which experiments a model fails."""

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from cophy.dataset.counterfactual import select, to_batch
from cophy.dataset.difficulty import difficulty
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import Part
from cophy.intervals import interval, mean
from cophy.report.figures import in_order, read_predictions, row_name
from cophy.training.metrics import mean_squared_error
from cophy.types import Batch, Prediction

log = logging.getLogger(__name__)

SECTION = ("scenario", "split", "positions", "size")
ALL = "all"
NAMED = {"cell": "cell", "do_operation": "do-operation"}
NUMBERS = {
    "displacement": "displacement (m)",
    "observed_difference": "AB: distance from the twin's (m)",
    "counterfactual_difference": "CD: distance from the twin's (m)",
    "observed_margin": "A: margin of the tower (m)",
    "counterfactual_margin": "C: margin of the tower (m)",
}
WORDS = {ALL: "all", **NAMED, **NUMBERS}
# what the words of a cell are about
CELLS = {"blocktower": "outcome of AB, of CD", "collision": "moving, static object"}
PANELS_PER_ROW = 4
SPREAD = 0.6  # of the models of one group, as a share of the distance between groups
SAME_RUN = 1e-4  # relative: float32, summed in another order
EXPLANATION = """# MSE by difficulty

The default split of each scenario, test experiments, mean over seeds. [ ]: 95 % bootstrap interval over the twin pairs of the group; n:
experiments in it. What is a number is broken down by thirds.

- cell: what the generator was told to make. Towers: outcome of AB, outcome of CD; collisions: moving object, static object.
- displacement: by the do-operation; removals have none.
- distance from the twin's: between two sequences that differ in their confounders alone, averaged over time, of the object
  that differs most. AB: how distinguishable AB is. CD: how much the confounders matter.
- margin: by statics under the true confounders, how far the tower's centre of mass is from where its outcome flips.
"""


def breakdown(runs: pd.DataFrame, arrays: dict[str, np.ndarray], spec: DatasetSpec, part: Part) -> pd.DataFrame:
    """One line per row of a table and group of experiments: experiments, seeds, mse (m²), low and high of its interval.

    runs: finished predictors (see `read_runs`) that were tested on the `part` of this dataset. One whose predictions are
    of something else is left out; the log names it.
    """
    chosen = select(arrays | difficulty(arrays, spec), part, "test")
    truth, lines = to_batch(chosen, spec.scenario), []
    values = {name: chosen[name] for name in WORDS if name in chosen}
    for keys, found in runs.groupby([*SECTION, "model", "ablation"]):
        each = [error for run in found.to_dict("records") if (error := _errors(run, truth, spec)) is not None]
        if not each:
            continue
        names = [str(key) for key in keys]
        section = dict(zip(SECTION, names, strict=False)) | {"row": row_name(*names[-2:])}
        errors = np.mean(each, axis=0)
        for by, group, rows in groups(values):
            low, high = interval(errors[rows], chosen["twin"][rows])
            counts = {"experiments": int(rows.sum()), "seeds": len(each)}
            numbers = {"mse": mean(errors[rows]), "low": low, "high": high}
            lines.append({**section, "by": by, "group": group, **counts, **numbers})
    return pd.DataFrame(lines)


def groups(values: dict[str, np.ndarray]) -> Iterator[tuple[str, str, np.ndarray]]:
    """(by, name of the group, (experiment,) bool): all experiments, then those of each name, and thirds of each number.

    Equal numbers stay together, experiments without the number (NaN) are in no group, and empty groups are left out.
    """
    yield ALL, ALL, np.ones(len(next(iter(values.values()))), dtype=bool)
    for by, value in values.items():
        if by in NAMED:
            names = np.unique(value).tolist()
            found = [(name.replace("_", " "), value == name) for name in names] if len(names) > 1 else []
        else:
            known = ~np.isnan(value)
            edges = np.quantile(value[known], np.arange(4) / 3) if known.any() else np.full(4, np.nan)
            third = np.searchsorted(edges[1:3], value)
            found = [(f"{edges[k]:.3g} to {edges[k + 1]:.3g}", known & (third == k)) for k in range(3)]
        yield from ((by, name, rows) for name, rows in found if rows.any())


def page(lines: pd.DataFrame) -> str:
    """Markdown: per scenario, split, positions and size a table of groups × rows, those with the largest MSE first."""
    return "\n".join([EXPLANATION, *(f"## {', '.join(keys)}\n\n{_table(found)}\n" for keys, found in _sections(lines))])


def draw(lines: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    """Name and figure of each section of the page: a panel per way to break down, models (no ablations) with intervals."""
    for keys, found in _sections(lines):
        yield "-".join(["difficulty", *keys]), _panels(found, ", ".join(keys))


def _sections(lines: pd.DataFrame) -> Iterator[tuple[list[str], pd.DataFrame]]:
    for keys, found in lines.groupby(list(SECTION)):
        yield [str(key) for key in keys if key != "ground_truth"], found


def _panels(frame: pd.DataFrame, title: str) -> Figure:
    panels = [by for by in WORDS if by != ALL and by in set(frame["by"])]
    rows = -(-len(panels) // PANELS_PER_ROW)
    columns = -(-len(panels) // rows)
    figure = Figure(figsize=(1.6 + 3.0 * columns, 0.5 + 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    axes[0, 0].set_yscale("function", functions=(lambda mse: np.sqrt(np.maximum(mse, 0)), np.square))
    for axis, by in zip(axes.flat, panels, strict=False):
        _panel(axis, frame, by)
    axes[0, 0].set_ylim(0, 1.05 * frame["high"][~frame["row"].map(_is_ablation)].max())
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    for first in axes[:, 0]:
        first.set_ylabel("MSE (m²), square-root scale")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    return figure


def _panel(axis: Any, frame: pd.DataFrame, by: str) -> None:
    models = [name for name in _by_error(frame) if not _is_ablation(name)]
    colors = {name: f"C{n}" for n, name in enumerate(in_order(frame["row"].unique()))}
    shown = frame[frame["by"] == by]
    groups = shown["group"].unique().tolist()
    for n, name in enumerate(models):
        found = shown[shown["row"] == name]
        at = [groups.index(group) + SPREAD * ((n + 0.5) / len(models) - 0.5) for group in found["group"]]
        ends = [found["mse"] - found["low"], found["high"] - found["mse"]]
        line = "" if by in NAMED else "-"
        axis.errorbar(at, found["mse"], ends, fmt=f"o{line}", ms=4, lw=1.2, color=colors[name], label=name)
    axis.set_xticks(range(len(groups)), [group.replace(" ", "\n", 1) for group in groups], fontsize="small")
    axis.set_xlim(-0.5, len(groups) - 0.5)
    cells = CELLS.get(frame["scenario"].iloc[0]) if by == "cell" else None
    axis.set_title(f"cell: {cells}" if cells else WORDS[by], fontsize="medium")
    axis.grid(axis="y", alpha=0.2)


def _is_ablation(row: str) -> bool:
    return " " in row


def _errors(run: dict[Any, Any], truth: Batch, spec: DatasetSpec) -> np.ndarray | None:
    """(experiment,) MSE of one run, or None where its predictions are not of this test split or not those it was judged by."""
    directory = run["directory"]
    found = read_predictions(directory)
    if spec.id not in run["dataset_ids"] or not (
        np.array_equal(found["target"], truth.target) and np.array_equal(found["presence"], truth.target_presence)
    ):
        log.error("%s: its predictions are not of the test split of %s: run that row again", directory, spec.id)
        return None
    prediction = Prediction(torch.from_numpy(found["position"]))
    errors = mean_squared_error(spec.scenario.task.metric_dims)(prediction, truth).double().numpy()
    if not np.isclose(errors.mean(), run["mse"], rtol=SAME_RUN):
        log.error("%s: its predictions have MSE %.6f, its metrics.json says %.6f: run that row again",
                  directory, errors.mean(), run["mse"])  # fmt: skip
        return None
    return np.asarray(errors)


def _table(frame: pd.DataFrame) -> str:
    text = (
        frame["mse"].map("{:.3f}".format) + frame["low"].map(" [{:.3f}, ".format) + frame["high"].map("{:.3f}]".format)
    )
    cells = frame.assign(text=text, by=frame["by"].map(WORDS)).rename(columns={"experiments": "n"})
    wide = cells.pivot_table(index=["by", "group", "n"], columns="row", values="text", aggfunc="first", sort=False)
    return str(wide[_by_error(frame)].reset_index().to_markdown(index=False))


def _by_error(frame: pd.DataFrame) -> list[str]:
    """Names of rows, the largest MSE over all experiments first."""
    return frame[frame["by"] == ALL].sort_values("mse", ascending=False)["row"].tolist()
