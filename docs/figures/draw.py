"""Draw the figures of the concepts page and of the README: python docs/figures/draw.py

Experiments are of `size=tiny`, which is generated in `data/` first where it is missing.
"""

import csv
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from cophy.config import generated_by, settings
from cophy.dataset import generation
from cophy.drawing.overview import render_sequence
from cophy.scenario import Camera
from cophy.scenario.rendering import Renderer
from cophy.scenario.towers import TOWER_CELLS
from cophy.schemas import register

HERE = Path(__file__).parent
RUNS = HERE.parent / "results" / "results.csv"
EXPERIMENT = 4  # A falls, C stands; its twin, 5, falls in both
NEAR = Camera(eye=[-0.35, -9.5, 2.9], target=[-0.35, 0.0, 1.3], field_of_view_deg=32)
PIXELS = 420
OBSERVED, COUNTERFACTUAL, DO = "#1f5fa8", "#a8561f", "#1d7a3d"


class Towers:
    """The tiny towers of three, seen from nearer than the dataset's own camera."""

    def __init__(self) -> None:
        chosen = settings("generate", "scenario=blocktower", "size=tiny", "num_objects=[3]")
        states = generated_by(chosen)[0]
        generation.ensure(states, workers=chosen.workers)
        self.arrays = states.load()
        self.scenario = replace(states.spec.scenario, camera=NEAR)
        seen = states.spec.scenario.seen_configurations(3, states.spec.data_seed)
        assert seen is not None, "towers have a seen half"
        self.seen = seen

    def frames(self, experiment: int, sequence: int, times: list[int]) -> np.ndarray:
        """(T, R, R, 3) of AB (0) or CD (1)."""
        with Renderer(self.scenario, PIXELS) as renderer:
            return render_sequence(renderer, self.arrays, experiment, sequence, times).rgb

    def confounders(self, experiment: int) -> str:
        """Masses by colour and gravity, in words."""
        masses = zip(self.scenario.colors, self.arrays["mass"][experiment], strict=True)
        x, y, _ = self.arrays["gravity"][experiment]
        return ", ".join(f"{color} {mass:g} kg" for color, mass in masses if mass) + f"; gravity x {x:g}, y {y:g} m/s²"


def show(axis: Axes, picture: np.ndarray, title: str, color: str) -> None:
    """A picture in a coloured frame, under its title."""
    axis.imshow(picture)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_title(title, color=color, fontsize=11, pad=4)
    for spine in axis.spines.values():
        spine.set(color=color, linewidth=2)


def note(figure: Figure, x: float, y: float, text: str, **style: object) -> None:
    """Text at a place of the whole figure."""
    figure.text(x, y, text, **{"ha": "center", "va": "center", "fontsize": 10, **style})  # type: ignore[arg-type]


def arrow(figure: Figure, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    """An arrow between two places of the whole figure."""
    style = {"arrowstyle": "-|>", "lw": 2, "color": color}
    figure.add_artist(
        mpl.text.Annotation(
            "", xy=end, xytext=start, xycoords="figure fraction", textcoords="figure fraction", arrowprops=style
        )
    )


def task(towers: Towers) -> Figure:
    """A, B, C and D of one experiment, with the do-operation named."""
    figure = Figure(figsize=(10, 6.2))
    axes = figure.subplots(2, 4)
    figure.subplots_adjust(left=0.11, right=0.985, top=0.93, bottom=0.085, wspace=0.06, hspace=0.42)
    slot = int(towers.arrays["do_slot"][EXPERIMENT])
    x = float(towers.arrays["do_offset"][EXPERIMENT][0])
    color = list(towers.scenario.colors)[slot]
    between = ("after 0.8 s", "after 1 s")
    titles = (("A: the start", *between, "B: the outcome"), ("C: A, changed", *between, "D: the outcome"))
    for sequence, edge in ((0, OBSERVED), (1, COUNTERFACTUAL)):
        pictures = towers.frames(EXPERIMENT, sequence, [0, 4, 5, 29])
        for axis, picture, title in zip(axes[sequence], pictures, titles[sequence], strict=True):
            show(axis, picture, title, edge)
    for axis in axes[1, 1:]:
        axis.images[0].set_alpha(0.55)
    note(figure, 0.05, 0.73, "AB\nobserved:\na model\nsees all\nof it", color=OBSERVED, fontsize=11)
    note(figure, 0.05, 0.27, "CD\na model\nsees C\nand has to\npredict D", color=COUNTERFACTUAL, fontsize=11)
    arrow(figure, (0.215, 0.545), (0.215, 0.455), DO)
    side = "left" if x < 0 else "right"
    note(
        figure, 0.23, 0.5, f"do-operation: move {color} {abs(x):.2f} m to the {side}", color=DO, ha="left", fontsize=11
    )
    hidden = "Hidden, and the same in both rows: masses, frictions and the direction of gravity (the confounders)."
    note(figure, 0.55, 0.035, hidden, fontsize=11)
    return figure


def twins(towers: Towers) -> Figure:
    """Two experiments that share A and C, and differ in their confounders."""
    figure = Figure(figsize=(10, 6.2))
    axes = figure.subplots(2, 4)
    figure.subplots_adjust(left=0.11, right=0.985, top=0.87, bottom=0.03, wspace=0.06, hspace=0.36)
    for row, experiment in enumerate((EXPERIMENT, EXPERIMENT + 1)):
        ab, cd = (towers.frames(experiment, sequence, [0, 29]) for sequence in (0, 1))
        for axis, picture, title in zip(axes[row], (*ab, *cd), "ABCD", strict=True):
            show(axis, picture, title, OBSERVED if title in "AB" else COUNTERFACTUAL)
        top = axes[row, 0].get_position().y1
        note(figure, 0.11, top + 0.075, f"Hidden: {towers.confounders(experiment)}", ha="left", fontsize=11)
        note(figure, 0.05, top - 0.18, ("a twin", "the other\ntwin")[row], fontsize=12)
    return figure


def cells(towers: Towers) -> Figure:
    """One tower of each cell, and how many experiments each has."""
    counts = np.bincount(towers.arrays["cell"])
    kinds = np.flatnonzero(counts).tolist()
    figure = Figure(figsize=(10, 5.9))
    axes = figure.subplots(2, len(kinds))
    figure.subplots_adjust(left=0.07, right=0.985, top=0.82, bottom=0.03, wspace=0.08, hspace=0.16)
    for column, cell in enumerate(kinds):
        experiment = int(np.flatnonzero(towers.arrays["cell"] == cell)[0])
        for sequence, edge in ((0, OBSERVED), (1, COUNTERFACTUAL)):
            picture = towers.frames(experiment, sequence, [29])[0]
            show(axes[sequence, column], picture, "BD"[sequence], edge)
        box = axes[0, column].get_position()
        text = f"{outcome(cell)}\n{counts[cell]} of {len(towers.arrays['cell'])} experiments"
        note(figure, (box.x0 + box.x1) / 2, 0.935, text, fontsize=11)
    note(figure, 0.03, 0.64, "end\nof AB", color=OBSERVED)
    note(figure, 0.03, 0.23, "end\nof CD", color=COUNTERFACTUAL)
    return figure


def outcome(index: int) -> str:
    """A cell of towers in words."""
    cell, words = TOWER_CELLS[index], ("falls", "stands")
    twin = ", the twin's too" if cell.observed == cell.twin.observed else f", the twin's {words[cell.twin.observed]}"
    return (
        f"A {words[cell.observed]}{twin};\nC {words[cell.counterfactual]}, the twin's {words[cell.twin.counterfactual]}"
    )


def seen_and_unseen(towers: Towers) -> Figure:
    """Which combinations of masses and gravity the splits with † train on."""
    grid, heights = towers.scenario.confounders, 3
    decoded = [grid.decode(index, heights) for index in range(len(towers.seen))]
    masses = sorted({tuple(float(m) for m in each.mass) for each in decoded})
    gravities = sorted({tuple(float(g) for g in each.gravity_xy) for each in decoded})
    table = np.zeros((len(masses), len(gravities)), bool)
    for each, seen in zip(decoded, towers.seen, strict=True):
        row = masses.index(tuple(float(m) for m in each.mass))
        table[row, gravities.index(tuple(float(g) for g in each.gravity_xy))] = seen
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axis = figure.subplots()
    axis.imshow(table, cmap=mpl.colors.ListedColormap(["#f2c9a8", "#a9c8ea"]), vmin=0, vmax=1, aspect="auto")
    for (row, column), seen in np.ndenumerate(table):
        axis.text(column, row, "seen" if seen else "unseen", ha="center", va="center", fontsize=9)
    axis.set_xticks(range(len(gravities)), [f"{x:g}, {y:g}" for x, y in gravities])
    axis.set_yticks(range(len(masses)), [", ".join(f"{m:g}" for m in each) for each in masses])
    axis.set(xlabel="gravity along x and y (m/s²)", ylabel="masses from the bottom up (kg)")
    return figure


def box(axis: Axes, x: float, text: str, color: str, width: float = 1.5) -> None:
    """A rounded box with text around x."""
    patch = FancyBboxPatch(
        (x - width / 2, 0.2), width, 0.6, boxstyle="round,pad=0.02,rounding_size=0.08", fc=color, ec="0.3"
    )
    axis.add_patch(patch)
    axis.text(x, 0.5, text, ha="center", va="center", fontsize=11)


def probe() -> Figure:
    """From AB to U, and from U to what the probe is asked."""
    figure = Figure(figsize=(10, 2.3))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set(xlim=(0, 10), ylim=(-0.35, 1.15))
    axis.set_axis_off()
    boxes = (
        (1.0, "AB\n(positions)", "#dbe8f6", 1.5),
        (3.3, "CoPhyNet's\nestimator, frozen", "#eeeeee", 1.9),
        (5.4, "U, a vector\nper object", "#e7dcf3", 1.4),
        (7.2, "linear\nclassifier", "#eeeeee", 1.2),
        (9.05, "mass and friction\nof the object?", "#dcefdc", 1.6),
    )
    for x, text, color, width in boxes:
        box(axis, x, text, color, width)
    ends = [(x - width / 2, x + width / 2) for x, _, _, width in boxes]
    for (_, right), (left, _) in pairwise(ends):
        axis.annotate("", (left - 0.03, 0.5), (right + 0.03, 0.5), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
    axis.text(7.2, -0.12, "the only part that is trained here", ha="center", fontsize=10)
    axis.text(3.3, -0.12, "trained before, to predict D", ha="center", fontsize=10)
    return figure


def oracles() -> Figure:
    """MSE of collisions between the two oracles, from the runs beside docs/results/tables.md."""
    mse: dict[str, list[float]] = defaultdict(list)
    with RUNS.open() as file:
        for run in csv.DictReader(file):
            own = [run[name] for name in ("scenario", "split", "ablation", "positions", "size", "variant")]
            if own == ["collision", "all", "full", "ground_truth", "small", ""]:
                mse[run["model"]].append(float(run["mse"]))
    names = {"oracle_feedforward": "oracle without AB", "oracle_counterfactual": "oracle with AB", "copy_b": "copy B"}
    names |= {"in": "IN (without AB)", "cophynet": "CoPhyNet"}
    worst, best = (fmean(mse[name]) for name in ("oracle_feedforward", "oracle_counterfactual"))
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axis = figure.subplots()
    values = {text: fmean(mse[name]) for name, text in names.items()}
    values = dict(sorted(values.items(), key=lambda item: -item[1]))
    bars = axis.barh(
        list(values), list(values.values()), color=["#c9b6e4" if "oracle" in n else "#a9c8ea" for n in values]
    )
    for bar, value in zip(bars, values.values(), strict=True):
        label = f"{value:.3f} m²: {100 * (worst - value) / (worst - best):.0f} % of the possible gain"
        axis.text(
            value + 0.01, bar.get_y() + bar.get_height() / 2, label, va="center", fontsize=10, backgroundcolor="white"
        )
    axis.axvline(worst, color="0.4", ls=":", zorder=0)
    axis.axvline(best, color="0.4", ls=":", zorder=0)
    axis.set(xlabel="MSE of D in collisions (m²), mean over seeds; lower is better", xlim=(0, 1.05))
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def figures() -> dict[str, Figure]:
    """All figures by the names of their files; data are looked for in the working directory."""
    register()
    towers = Towers()
    return {
        "task": task(towers),
        "twins": twins(towers),
        "cells": cells(towers),
        "seen_and_unseen": seen_and_unseen(towers),
        "probe": probe(),
        "oracles": oracles(),
    }


if __name__ == "__main__":
    for name, figure in figures().items():
        figure.savefig(HERE / f"{name}.png", dpi=110)
