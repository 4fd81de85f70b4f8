"""MSE by difficulty as a page and as figures."""

import textwrap
from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cophy.report.figures import in_order
from cophy.report.mse_by_difficulty import ALL, NAMED, SECTION, WORDS
from cophy.scenario import Scenario

MAX_PANELS_PER_ROW = 4
PANEL_LETTERS = 42  # that fit beside each other below a panel
GROUP_WIDTH = 0.6  # of all models of a group together, as a share of the distance between groups
EXPLANATION = """# MSE by difficulty

The default split of each scenario, test experiments, mean over seeds. [ ]: 95 % bootstrap interval over the twin pairs of the group; n:
experiments in it. What is a number is broken down by thirds.

- cell: what the generator was told to make ({cells}).
- cells of both twins: the same, for twin pairs. A second table has the share of the twins' difference that a row explains in
  each: 0 % for any model without AB, 100 % for a perfect one.
- displacement: by the do-operation; removals have none.
- distance from the twin's: between two sequences that differ in their confounders alone, averaged over time, of the object
  that differs most. AB: how distinguishable AB is. CD: how much the confounders matter.
- margin: by statics under the true confounders, how far the tower's centre of mass is from where its outcome flips.
"""


def page(lines: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> str:
    """Markdown: per scenario, split, positions and size a table of groups × rows, those with the largest MSE first."""
    meanings = [f"{name}: {meaning}" for name, scenario in scenarios.items() if (meaning := scenario.cell_meaning())]
    explanation = EXPLANATION.format(cells="; ".join(meanings) or "there is only one")
    return "\n".join([explanation, *(f"## {', '.join(keys)}\n\n{_table(found)}\n" for keys, found in _sections(lines))])


def draw(lines: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> Iterator[tuple[str, Figure]]:
    """Name and figure of each section of the page: a panel per way to break down, models (no ablations) with intervals."""
    for keys, found in _sections(lines):
        meaning = scenarios[keys[0]].cell_meaning()
        titles = {**WORDS, "cell": f"cell: {meaning}" if meaning else "cell"}
        yield "-".join(["difficulty", *keys]), _panels(found, ", ".join(keys), titles)


def _sections(lines: pd.DataFrame) -> Iterator[tuple[list[str], pd.DataFrame]]:
    for keys, found in lines.groupby(list(SECTION)):
        yield [str(key) for key in keys if key != "ground_truth"], found


def _panels(frame: pd.DataFrame, title: str, titles: Mapping[str, str]) -> Figure:
    panels = [by for by in WORDS if by != ALL and by in set(frame["by"])]
    rows = -(-len(panels) // MAX_PANELS_PER_ROW)
    columns = -(-len(panels) // rows)
    figure = Figure(figsize=(1.6 + 3.0 * columns, 0.5 + 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    axes[0, 0].set_yscale("function", functions=(lambda mse: np.sqrt(np.maximum(mse, 0)), np.square))
    for axis, by in zip(axes.flat, panels, strict=False):
        _panel(axis, frame, by, titles[by])
    axes[0, 0].set_ylim(0, 1.05 * frame["high"][frame["row"].isin(_shown(frame))].max())
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    for first in axes[:, 0]:
        first.set_ylabel("MSE (m²), square-root scale")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    return figure


def _panel(axis: Axes, frame: pd.DataFrame, by: str, title: str) -> None:
    models = _shown(frame)
    colors = {name: f"C{n}" for n, name in enumerate(in_order(frame["row"].unique()))}
    shown = frame[frame["by"] == by]
    groups = shown["group"].unique().tolist()
    for n, name in enumerate(models):
        found = shown[shown["row"] == name]
        at = [groups.index(group) + GROUP_WIDTH * ((n + 0.5) / len(models) - 0.5) for group in found["group"]]
        ends = [found["mse"] - found["low"], found["high"] - found["mse"]]
        line = "" if by in NAMED else "-"
        axis.errorbar(at, found["mse"], ends, fmt=f"o{line}", ms=4, lw=1.2, color=colors[name], label=name)
    room = PANEL_LETTERS // len(groups)
    labels = [textwrap.fill(group, room, break_long_words=False) for group in groups]
    axis.set_xticks(range(len(groups)), labels, fontsize="small")
    axis.set_xlim(-0.5, len(groups) - 0.5)
    axis.set_title(title, fontsize="medium")
    axis.grid(axis="y", alpha=0.2)


def _shown(frame: pd.DataFrame) -> list[str]:
    """Rows in a figure: models without their ablations, or what there is."""
    rows = _by_error(frame)
    return [row for row in rows if " " not in row] or rows


def _explained(frame: pd.DataFrame) -> str:
    """The share of the twins' difference that is explained, where groups hold whole pairs of several kinds."""
    if "twins" not in set(frame["by"]):
        return ""
    of_pairs = frame[frame["explained"].notna()]
    text = [
        f"{explained:.0%} [{low:.0%}, {high:.0%}]"
        for explained, low, high in of_pairs[["explained", "explained_low", "explained_high"]].itertuples(index=False)
    ]
    return f"Of the twins' difference, explained:\n\n{_wide(of_pairs.assign(text=text))}\n"


def _table(frame: pd.DataFrame) -> str:
    text = (
        frame["mse"].map("{:.3f}".format) + frame["low"].map(" [{:.3f}, ".format) + frame["high"].map("{:.3f}]".format)
    )
    return f"{_wide(frame.assign(text=text))}\n\n{_explained(frame)}"


def _wide(frame: pd.DataFrame) -> str:
    cells = frame.assign(by=frame["by"].map(WORDS)).rename(columns={"experiments": "n"})
    wide = cells.pivot_table(index=["by", "group", "n"], columns="row", values="text", aggfunc="first", sort=False)
    return str(wide[_by_error(frame)].reset_index().to_markdown(index=False))


def _by_error(frame: pd.DataFrame) -> list[str]:
    """Names of rows, the largest MSE over all experiments first."""
    return frame[frame["by"] == ALL].sort_values("mse", ascending=False)["row"].tolist()
