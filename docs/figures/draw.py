"""Draw the figures of the concepts page and of the README: python docs/figures/draw.py

Experiments are of `size=tiny`, which is generated in `data/` first where it is missing.
"""

import csv
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

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
SEEN, UNSEEN = "#5b93d1", "#f2c9a8"
ROWS = {  # of the figure of oracles: name -> model
    "copy B": "copy_b",
    "IN": "in",
    "oracle without AB": "oracle_feedforward",
    "CoPhyNet": "cophynet",
    "alongside": "alongside",
    "oracle with AB": "oracle_counterfactual",
}
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
    """Draw which combinations of masses and gravity the splits with † train on."""
    grid, heights = towers.scenario.confounders, 3
    decoded = [grid.decode(index, heights) for index in range(len(towers.seen))]
    masses = sorted(
        {tuple(float(m) for m in each.mass) for each in decoded},
        key=lambda m: ([mass / min(m) for mass in m], m),  # multiples of the same masses next to each other
    )
    gravities = sorted({tuple(float(g) for g in each.gravity_xy) for each in decoded})
    table = np.zeros((len(masses), len(gravities)), bool)
    for each, seen in zip(decoded, towers.seen, strict=True):
        row = masses.index(tuple(float(m) for m in each.mass))
        table[row, gravities.index(tuple(float(g) for g in each.gravity_xy))] = seen
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.pcolormesh(table, cmap=mpl.colors.ListedColormap([UNSEEN, SEEN]), vmin=0, vmax=1, edgecolors="white", lw=2)
    axis.invert_yaxis()
    axis.set_xticks(np.arange(len(gravities)) + 0.5, [f"{x:g}, {y:g}" for x, y in gravities], fontsize=12)
    axis.set_yticks(np.arange(len(masses)) + 0.5, [", ".join(f"{m:g}" for m in each) for each in masses], fontsize=12)
    axis.set_xlabel("gravity along x and y (m/s²)", fontsize=12)
    axis.set_ylabel("masses from the bottom up (kg)", fontsize=12)
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    handles = [Patch(color=SEEN, label="seen in training"), Patch(color=UNSEEN, label="unseen: tested (†)")]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False, fontsize=12)
    return figure


def oracles() -> Figure:
    """Draw the MSE of collisions between those of the two oracles, from docs/results/results.csv."""
    wanted = {"scenario": "collision", "split": "all", "ablation": "full", "positions": "ground_truth", "size": "paper"}
    wanted |= {"variant": "+size-paper"}
    found: dict[str, list[dict[str, str]]] = defaultdict(list)
    with RUNS.open() as file:
        for run in csv.DictReader(file):
            if all(run[key] == value for key, value in wanted.items()):
                found[run["model"]].append(run)
    runs = {name: found[model] for name, model in ROWS.items()}
    mse = {name: fmean(float(run["mse"]) for run in each) for name, each in runs.items()}
    names = sorted(runs, key=lambda name: -mse[name])
    figure = Figure(figsize=(7.6, 3.4))
    axis = figure.add_axes((0.225, 0.17, 0.52, 0.6))
    colors = ["#c9b6e4" if "oracle" in name else "#a9c8ea" for name in names]
    axis.barh(names, [mse[name] for name in names], color=colors)
    for row, name in enumerate(names):
        share = fmean(float(run["share"]) for run in runs[name])
        axis.text(mse[name] + 0.008, row, f"{mse[name]:.3f}", va="center", fontsize=12)
        axis.text(
            1.26,
            row,
            f"{100 * share:.0f} %",
            va="center",
            ha="right",
            fontsize=12,
            transform=axis.get_yaxis_transform(),
        )
    axis.text(1.29, 1.04, "share of the\npossible gain", ha="right", fontsize=12, transform=axis.transAxes)
    for name, text in (("oracle with AB", "best with AB"), ("oracle without AB", "best without AB")):
        axis.axvline(mse[name], color="0.35", ls=":", zorder=0)
        axis.annotate(
            text, (mse[name], 1.04), xycoords=axis.get_xaxis_transform(), ha="center", fontsize=12, color="0.35"
        )
    counts = [{int(float(run["num_test"])) for run in runs[name]} for name in ("CoPhyNet", "oracle with AB")]
    (tests,), (of_oracles,) = counts
    title = f"Collisions, size=paper: {tests:,} test experiments, {of_oracles:,} of them for oracles"
    figure.text(0.5, 0.955, title, ha="center", va="center", fontsize=12)
    axis.set_xlabel("MSE of D (m²), mean over seeds; lower is better", fontsize=12)
    axis.set(xlim=(0, 0.72))
    axis.tick_params(labelsize=12)
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
        "oracles": oracles(),
    }


if __name__ == "__main__":
    for name, figure in figures().items():
        figure.savefig(HERE / f"{name}.png", dpi=110)
