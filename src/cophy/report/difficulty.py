"""MSE by difficulty, do-operation and cell: on which experiments a model fails, as a table, a page and figures."""

import logging
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cophy.bootstrap import interval, mean
from cophy.dataset.difficulty import difficulty
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import Part
from cophy.dataset.states import sort_by_twins
from cophy.drawing.plots import square_root, style
from cophy.report.figures import row_name, row_title, sort_rows
from cophy.report.render import interval as interval_text
from cophy.report.runs import comparable_seeds
from cophy.scenario import Scenario
from cophy.scoring import Scores, average

log = logging.getLogger(__name__)

SECTION = ("scenario", "split", "positions", "size")
EVERYTHING = "all"
CATEGORIES = {"cell": "cell", "twins": "cells of both twins", "do_operation": "do-operation"}
WHOLE_PAIRS = (EVERYTHING, "twins")  # these groups hold whole twin pairs
QUANTITIES = {
    "displacement": "displacement (m)",
    "observed_difference": "AB: distance from the twin's (m)",
    "counterfactual_difference": "CD: distance from the twin's (m)",
    "observed_margin": "A: margin of the tower (m)",
    "counterfactual_margin": "C: margin of the tower (m)",
}
TITLES = {EVERYTHING: "all", **CATEGORIES, **QUANTITIES}


def mse_by_difficulty(
    runs: pd.DataFrame, scores: Mapping[Path, Scores], arrays: dict[str, np.ndarray], spec: DatasetSpec, part: Part
) -> pd.DataFrame:
    """Break the test MSE of runs down by what makes an experiment hard.

    Args:
        runs: Finished predictors (see `read_runs`) that were tested on this part of the dataset. A run whose predictions
            are not of the whole test split is left out; the log names it. A row shows its `comparable_seeds`.
        scores: Scores of the runs by directory.
        part: The part that is tested on.

    Returns:
        One line per row of a table and group of experiments: experiments, seeds, mse (m²), low and high of its interval.
        Where groups hold whole twin pairs (WHOLE_PAIRS): explained, explained_low and explained_high, shares of the twins'
        difference; NaN elsewhere.
    """
    arrays = sort_by_twins(arrays, spec)
    tested, lines = np.flatnonzero(part.select_split(arrays, "test", spec.scenario)), []
    ids, truth = arrays["experiment"][tested], _truth(arrays, spec.scenario)[tested]
    measures = difficulty(arrays, spec)
    values = {name: measures[name][tested] for name in TITLES if name in measures}
    for keys, row_runs in runs.groupby([*SECTION, "model", "ablation"]):
        seeds = [
            of_seed
            for run in comparable_seeds(row_runs).to_dict("records")
            if (of_seed := _aligned(scores[run["directory"]], ids, truth, run, spec)) is not None
        ]
        if not seeds:
            continue
        names = [str(key) for key in keys]
        section = dict(zip(SECTION, names, strict=False)) | {"row": row_name(*names[-2:])}
        all_scores = average(seeds)
        for by, group, rows in groups(values):
            group_scores = all_scores.select(rows)
            low, high = interval(group_scores.mse, group_scores.cluster)
            counts = {"experiments": int(rows.sum()), "seeds": len(seeds)}
            numbers = {"mse": mean(group_scores.mse), "low": low, "high": high}
            explained = group_scores.values.get("twin_difference_explained")
            if by in WHOLE_PAIRS and explained is not None:
                ends = interval(explained, group_scores.cluster)
                numbers |= {"explained": mean(explained), "explained_low": ends[0], "explained_high": ends[1]}
            lines.append({**section, "by": by, "group": group, **counts, **numbers})
    return pd.DataFrame(lines)


def groups(values: dict[str, np.ndarray]) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yield by, name of the group, (experiment,) bool: all experiments, each category, and thirds of each number.

    Equal numbers stay together, experiments without the number (NaN) are in no group, and empty groups are left out.
    """
    yield EVERYTHING, EVERYTHING, np.ones(len(next(iter(values.values()))), dtype=bool)
    for by, value in values.items():
        parts = _categories(value) if by in CATEGORIES else _thirds(value)
        yield from ((by, name, rows) for name, rows in parts if rows.any())


def _categories(value: np.ndarray) -> list[tuple[str, np.ndarray]]:
    names = np.unique(value).tolist()
    return [(name.replace("_", " "), value == name) for name in names] if len(names) > 1 else []


def _thirds(value: np.ndarray) -> list[tuple[str, np.ndarray]]:
    known = ~np.isnan(value)
    edges = np.quantile(value[known], np.arange(4) / 3) if known.any() else np.full(4, np.nan)
    third = np.searchsorted(edges[1:3], value)
    return [(f"{edges[k]:.3g} to {edges[k + 1]:.3g}", known & (third == k)) for k in range(3)]


def _truth(arrays: dict[str, np.ndarray], scenario: Scenario) -> np.ndarray:
    """Return the (experiment,) sums of the true coordinates of D, see `Scores.truth`."""
    stride, present = scenario.clock.states_per_frame, arrays["presence"][:, 1, None, :, None]
    positions = np.where(present, arrays["states"][:, 1, stride::stride, :, :3], 0.0)
    return np.asarray(positions.sum(axis=(1, 2, 3), dtype=np.float64))


def _aligned(
    scores: Scores, ids: np.ndarray, truth: np.ndarray, run: dict[Any, Any], spec: DatasetSpec
) -> Scores | None:
    """Return the scores of one run in the order of the ids; None where they are not of this whole test split."""
    directory, count, total = run["directory"], len(scores.experiment), len(ids)
    _, rows, stored = np.intersect1d(ids, scores.experiment, return_indices=True)
    is_of_data = spec.id in run["dataset_ids"] and len(rows) == count
    if not is_of_data or not np.allclose(scores.truth[stored], truth[rows]):
        log.error("%s: its predictions are not of the test split of %s: run it again", directory, spec.id)
        return None
    if count < total:  # an oracle; its groups would hold other experiments than those of the models
        log.info("%s: not in MSE by difficulty, as it predicted %d of %d test experiments", directory, count, total)
        return None
    return scores.select(stored[np.argsort(rows)])


MAX_PANELS_PER_ROW = 4
PANEL_IN, PANEL_LETTERS = 3.0, 42  # that fit next to each other below a panel
MIN_EXPERIMENTS = 40  # of a split, for intervals and lines between thirds
GROUP_WIDTH = 0.6  # of all models of a group together, as a share of the distance between groups
EXPLANATION = """# MSE by difficulty

The default split of each scenario, test experiments, mean over seeds. [ ]: 95 % bootstrap interval over the clusters of the group; n:
experiments in it. Numbers are broken down by thirds.

- cell: what the generator was asked for ({cells}).
- cells of both twins: the same, for twin pairs. A second table has the share of the twins' difference that a row explains in
  each: 0 % for any model without AB, 100 % for a perfect one.
- displacement: by the do-operation; removals have none.
- distance from the twin's: between two sequences that differ in their confounders alone, averaged over time, of the object
  that differs most. AB: how distinguishable AB is. CD: how much the confounders matter.
- margin: by statics under the true confounders, how far the tower's centre of mass is from where its outcome flips.
"""


def page(lines: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> str:
    """Return Markdown: a table of groups × rows per scenario, split, positions and size, the largest MSE first."""
    meanings = [f"{name}: {meaning}" for name, scenario in scenarios.items() if (meaning := scenario.cell_meaning())]
    explanation = EXPLANATION.format(cells="; ".join(meanings) or "there is only one")
    return "\n".join(
        [explanation, *(f"## {', '.join(keys)}\n\n{_table(section)}\n" for keys, section in _sections(lines))]
    )


def draw(lines: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of each section of the page: a panel per breakdown, models (no ablations) with intervals."""
    for keys, section in _sections(lines):
        meaning = scenarios[keys[0]].cell_meaning()
        titles = {**TITLES, "cell": f"cell: {meaning}" if meaning else "cell"}
        yield "-".join(["difficulty", *keys]), _panels(section, ", ".join(keys), titles)


def _sections(lines: pd.DataFrame) -> Iterator[tuple[list[str], pd.DataFrame]]:
    for keys, section in lines.groupby(list(SECTION)):
        yield [str(key) for key in keys if key != "ground_truth"], section


def _panels(frame: pd.DataFrame, title: str, titles: Mapping[str, str]) -> Figure:
    panels = [by for by in TITLES if by != EVERYTHING and by in set(frame["by"])]
    rows = -(-len(panels) // MAX_PANELS_PER_ROW)
    columns = -(-len(panels) // rows)
    figure = Figure(figsize=(1.6 + PANEL_IN * columns, 0.5 + PANEL_IN * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    axes[0, 0].set_yscale("function", functions=(square_root, np.square))
    for axis, by in zip(axes.flat, panels, strict=False):
        _panel(axis, frame, by, titles[by])
    axes[0, 0].set_ylim(0, 1.05 * frame["high"][frame["row"].isin(_drawn_rows(frame))].max())
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    for first in axes[:, 0]:
        first.set_ylabel("MSE (m²), square-root scale")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    caption = "too few experiments\nfor intervals" if _are_few(frame) else "95 % intervals"
    look = {"frameon": False, "title": caption, "fontsize": "small", "title_fontsize": "small"}
    figure.legend(handles, labels, loc="outside right center", **look)
    figure.suptitle(f"{title}, {frame['experiments'].max()} test experiments", fontsize="medium")
    return figure


def _panel(axis: Axes, frame: pd.DataFrame, by: str, title: str) -> None:
    models = _drawn_rows(frame)
    looks = {name: style(n) for n, name in enumerate(sort_rows(frame["row"].unique()))}
    are_few = _are_few(frame)
    panel = frame[frame["by"] == by]
    groups = panel["group"].unique().tolist()
    for n, name in enumerate(models):
        row = panel[panel["row"] == name]
        x = [groups.index(group) + GROUP_WIDTH * ((n + 0.5) / len(models) - 0.5) for group in row["group"]]
        ends = None if are_few else [row["mse"] - row["low"], row["high"] - row["mse"]]
        look = looks[name] | ({"linestyle": ""} if are_few or by in CATEGORIES else {})
        axis.errorbar(x, row["mse"], ends, ms=4, lw=1.2, label=row_title(name), **look)
    room = PANEL_LETTERS // len(groups)
    labels = [textwrap.fill(group, room, break_long_words=False) for group in groups]
    axis.set_xticks(range(len(groups)), labels, fontsize="small")
    axis.set_xlim(-0.5, len(groups) - 0.5)
    axis.set_title(textwrap.fill(title, PANEL_LETTERS - 8), fontsize="small")
    axis.grid(axis="y", alpha=0.2)


def _are_few(frame: pd.DataFrame) -> bool:
    return bool(frame["experiments"].max() < MIN_EXPERIMENTS)


def _drawn_rows(frame: pd.DataFrame) -> list[str]:
    """Return the rows of a figure: models without their ablations, or all rows if there are only ablations."""
    rows = _by_error(frame)
    return [row for row in rows if " " not in row] or rows


def _explained(frame: pd.DataFrame) -> str:
    """Return the explained share of the twins' difference, where groups hold whole pairs of several kinds."""
    if "twins" not in set(frame["by"]):
        return ""
    pairs = frame[frame["explained"].notna()]
    text = _with_intervals(pairs[["explained", "explained_low", "explained_high"]], ".0%")
    return f"Of the twins' difference, explained:\n\n{_wide(pairs.assign(text=text))}\n"


def _table(frame: pd.DataFrame) -> str:
    text = _with_intervals(frame[["mse", "low", "high"]], ".3f")
    return f"{_wide(frame.assign(text=text))}\n\n{_explained(frame)}"


def _with_intervals(numbers: pd.DataFrame, form: str) -> list[str]:
    """Return value, low and high of each line as text."""
    return [f"{value:{form}} {interval_text(low, high, form)}".strip() for value, low, high in numbers.to_numpy()]


def _wide(frame: pd.DataFrame) -> str:
    cells = frame.assign(by=frame["by"].map(TITLES)).rename(columns={"experiments": "n"})
    wide = cells.pivot_table(index=["by", "group", "n"], columns="row", values="text", aggfunc="first", sort=False)
    return str(wide[_by_error(frame)].rename(columns=row_title).reset_index().to_markdown(index=False))


def _by_error(frame: pd.DataFrame) -> list[str]:
    """Return the names of rows, the largest MSE over all experiments first."""
    return frame[frame["by"] == EVERYTHING].sort_values("mse", ascending=False)["row"].tolist()
