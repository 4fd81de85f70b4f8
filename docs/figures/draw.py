"""Draw the figures of the pages on the task and on metrics: python docs/figures/draw.py

The towers are generated here, one twin pair at a time; no dataset is needed.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Patch, Rectangle

from cophy.config import generated_by, settings
from cophy.dataset.images import render_sequence
from cophy.dataset.states import to_arrays
from cophy.scenario import Camera, Simulator
from cophy.scenario.rendering import Renderer
from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS
from cophy.schemas import register

HERE = Path(__file__).parent
NUM_BLOCKS = 3
TASK_PAIR, TASK_TWIN = 3, 1  # A falls for both twins; C stands for the second
CELL_PAIRS = (0, 16, 36)  # twin pairs with data seed 0, one of each kind; `cells` checks that they show all cells
NEAR = Camera(eye=[-0.2, -11.5, 3.4], target=[-0.2, 0.0, 1.25], field_of_view_deg=30)
PIXELS = 420
LAST = 29  # frame
SEEN, UNSEEN = "#5b93d1", "#f2c9a8"
OBSERVED, COUNTERFACTUAL, DO = "#1f5fa8", "#a8561f", "#1d7a3d"
FONT = 13  # points; legible when a figure is 390 pixels wide


class Twin(NamedTuple):
    """One experiment of a twin pair, as arrays of its pair and its row in them."""

    arrays: dict[str, np.ndarray]
    row: int

    @property
    def cell(self) -> int:
        """Index into TOWER_CELLS."""
        return int(self.arrays["cell"][self.row])

    @property
    def slots(self) -> list[int]:
        """Slots of A's blocks, from the ground up."""
        index = self.arrays["object_index"][self.row]
        return [int(np.flatnonzero(index == level)[0]) for level in range(NUM_BLOCKS)]


class Towers:
    """Towers of three with data seed 0, seen from nearer than by the dataset's own camera."""

    def __init__(self) -> None:
        # the size only limits the index of a pair; no dataset is generated
        self.spec = generated_by(settings("generate", "scenario=blocktower", "size=small", "num_objects=[3]"))[0].spec
        self.scenario = replace(self.spec.scenario, camera=NEAR)
        seen = self.scenario.seen_configurations(NUM_BLOCKS, self.spec.data_seed)
        assert seen is not None, "towers have a seen half"
        self.seen = seen

    @cache  # noqa: B019
    def twins(self, pair: int) -> tuple[Twin, Twin]:
        """Generate a twin pair."""
        with Simulator() as simulator:
            twins = self.scenario.twin_pair(NUM_BLOCKS, data_seed=0, pair=pair, simulator=simulator)
        arrays = to_arrays(twins, [2 * pair, 2 * pair + 1], self.spec)
        return Twin(arrays, 0), Twin(arrays, 1)

    def frames(self, twin: Twin, sequence: int, times: list[int]) -> np.ndarray:
        """Render frames of AB (0) or CD (1): (T, R, R, 3)."""
        with Renderer(self.scenario, PIXELS) as renderer:
            return render_sequence(renderer, twin.arrays, twin.row, sequence, times).rgb

    def do_operation(self, twin: Twin) -> str:
        """Describe the do-operation, as in "move the red block 0.40 m to the left"."""
        color = list(self.scenario.colors)[int(twin.arrays["do_slot"][twin.row])]
        x, y, _ = twin.arrays["do_offset"][twin.row]
        if x == y == 0:
            return f"remove the {color} block"
        side = ("to the left" if x < 0 else "to the right") if x else ("to the front" if y < 0 else "to the back")
        return f"move the {color} block {abs(x + y):.2f} m {side}"


def show(axis: Axes, picture: np.ndarray, title: str, color: str, *, style: str = "-") -> None:
    """Show a picture in a coloured frame, under its title."""
    axis.imshow(picture)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_title(title, color=color, fontsize=FONT, pad=4)
    for spine in axis.spines.values():
        spine.set(color=color, linewidth=2, linestyle=style)


def note(figure: Figure, x: float, y: float, text: str, **style: object) -> None:
    """Write text at a position of the whole figure."""
    figure.text(x, y, text, **{"ha": "center", "va": "center", "fontsize": FONT, **style})  # type: ignore[arg-type]


def ring(axis: Axes, towers: Towers, twin: Twin, sequence: int) -> None:
    """Ring the block that the do-operation changes, in the first frame of a sequence."""
    centre = twin.arrays["states"][twin.row, sequence, 0, int(twin.arrays["do_slot"][twin.row]), :3]
    x, y = towers.scenario.camera.project(centre, PIXELS)
    axis.add_patch(Ellipse((x, y), 0.34 * PIXELS, 0.29 * PIXELS, fc="none", ec=DO, lw=3))


def task(towers: Towers) -> Figure:
    """Draw A, B, C and D of one experiment, with the do-operation named."""
    twin = towers.twins(TASK_PAIR)[TASK_TWIN]
    figure = Figure(figsize=(6.4, 5.9))
    axes = figure.subplots(2, 3)
    figure.subplots_adjust(left=0.012, right=0.988, top=0.885, bottom=0.065, wspace=0.05, hspace=0.5)
    titles = (("A: start", "after 1 s", "B: outcome"), ("C: A, changed", "after 1 s", "D: outcome"))
    for sequence, edge in ((0, OBSERVED), (1, COUNTERFACTUAL)):
        pictures = towers.frames(twin, sequence, [0, 5, LAST])
        for column, (picture, title) in enumerate(zip(pictures, titles[sequence], strict=True)):
            predicted = sequence == 1 and column > 0
            show(axes[sequence, column], picture, title, edge, style="--" if predicted else "-")
        ring(axes[sequence, 0], towers, twin, sequence)
    left = {"ha": "left", "weight": "bold"}
    note(figure, 0.012, 0.96, "AB is observed: a model sees all of it", color=OBSERVED, **left)
    note(figure, 0.012, 0.47, "CD is counterfactual: a model sees C and predicts D", color=COUNTERFACTUAL, **left)
    note(figure, 0.012, 0.522, f"Do-operation: {towers.do_operation(twin)}", color=DO, **left)
    note(figure, 0.5, 0.03, "Hidden, the same in both rows: masses, frictions, gravity")
    return figure


def confounders(axis: Axes, towers: Towers, twin: Twin) -> None:
    """Draw the masses in a stack of squares, in the order of the tower, and horizontal gravity below it."""
    axis.set(xlim=(0, 3), ylim=(0, 3), aspect="equal")
    axis.set_axis_off()
    colors, edge = list(towers.scenario.colors.values()), 0.76
    for level, slot in enumerate(twin.slots):
        bottom = 0.68 + level * edge
        axis.add_patch(Rectangle((0.9, bottom), 1.2, edge, fc=colors[slot], ec="white", lw=2))
        mass = f"{twin.arrays['mass'][twin.row, slot]:g} kg"
        dark = np.dot(mpl.colors.to_rgb(colors[slot]), (0.3, 0.6, 0.1)) > 0.6
        axis.text(1.5, bottom + edge / 2, mass, ha="center", va="center", fontsize=FONT, color="k" if dark else "w")
    x, y, _ = twin.arrays["gravity"][twin.row]
    axis.text(1.5, 0.27, f"gravity x, y:\n{x:g}, {y:g} m/s²", ha="center", va="center", fontsize=FONT - 1)


def twins(towers: Towers) -> Figure:
    """Draw two experiments that share A and C, and differ in their confounders."""
    both = towers.twins(TASK_PAIR)
    figure = Figure(figsize=(6.4, 6.8))
    axes = figure.subplots(3, 3)
    figure.subplots_adjust(left=0.012, right=0.988, top=0.96, bottom=0.012, wspace=0.05, hspace=0.27)
    for sequence, column, title, edge in ((0, 0, "A", OBSERVED), (1, 2, "C", COUNTERFACTUAL)):
        show(axes[0, column], towers.frames(both[0], sequence, [0])[0], f"{title} of both twins", edge)
        ring(axes[0, column], towers, both[0], sequence)
    axes[0, 1].set_axis_off()
    words = towers.do_operation(both[0]).split()
    text = "do-operation:\n" + " ".join(words[:4]) + "\n" + " ".join(words[4:])
    axes[0, 1].text(0.5, 0.68, text, ha="center", va="center", fontsize=FONT, color=DO, transform=axes[0, 1].transAxes)
    style = {"arrowstyle": "-|>", "lw": 3, "color": DO}
    axes[0, 1].annotate("", (0.95, 0.42), (0.05, 0.42), xycoords="axes fraction", arrowprops=style)
    for row, twin in enumerate(both, start=1):
        confounders(axes[row, 1], towers, twin)
        axes[row, 1].set_title(f"hidden, twin {row}", fontsize=FONT, pad=4)
        for sequence, column, title, edge in ((0, 0, "B", OBSERVED), (1, 2, "D", COUNTERFACTUAL)):
            show(axes[row, column], towers.frames(twin, sequence, [LAST])[0], f"{title} of twin {row}", edge)
    return figure


def cells(towers: Towers) -> Figure:
    """Draw one tower of each cell: a row for each kind of twin pair, with the A and C that twins share.

    Raises:
        ValueError: The twin pairs CELL_PAIRS do not show every cell.
    """
    pairs = [towers.twins(pair) for pair in CELL_PAIRS]
    shown = [twin.cell for pair in pairs for twin in pair]
    if sorted(shown) != list(range(len(TOWER_CELLS))):
        names = ", ".join(TOWER_CELLS[cell].name for cell in shown)
        raise ValueError(f"CELL_PAIRS={CELL_PAIRS} show the cells {names}: choose one twin pair of each kind")
    figure = Figure(figsize=(8.2, 5.85))
    axes = figure.subplots(len(pairs), 6)
    figure.subplots_adjust(left=0.008, right=0.992, top=0.858, bottom=0.01, wspace=0.05, hspace=0.47)
    for row, pair in zip(axes, pairs, strict=True):
        columns: Sequence[tuple[Twin, int, int, str]] = (
            (pair[0], 0, 0, "A"),
            (pair[0], 1, 0, "C"),
            *((twin, sequence, LAST, "BD"[sequence]) for twin in pair for sequence in (0, 1)),
        )
        for axis, (twin, sequence, time, title) in zip(row, columns, strict=True):
            picture = towers.frames(twin, sequence, [time])[0]
            show(axis, picture, title, (OBSERVED, COUNTERFACTUAL)[sequence])
        top = row[0].get_position().y1 + 0.066
        for axis, twin in ((row[2], pair[0]), (row[4], pair[1])):
            left, right = axis.get_position().x0, axis.get_position().x1
            note(figure, right + 0.1 * (right - left) / 4, top, TOWER_CELLS[twin.cell].name, weight="bold")
        share = np.mean([cell in {twin.cell for twin in pair} for block in TOWER_BLOCKS for cell in block])
        note(figure, row[0].get_position().x0, top, f"{100 * share:.0f} % of pairs", ha="left")
    for axis, text in ((axes[0, 0], "both twins"), (axes[0, 2], "one twin"), (axes[0, 4], "the other twin")):
        box = axis.get_position()
        x = box.x1 + 0.1 * (box.x1 - box.x0) / 4
        note(figure, x, 0.975, text, color="0.35", style="italic")
    return figure


def seen_and_unseen(towers: Towers) -> Figure:
    """Draw which combinations of masses and gravity the splits with † train on."""
    grid = towers.scenario.confounders
    decoded = [grid.decode(index, NUM_BLOCKS) for index in range(len(towers.seen))]
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


def figures() -> dict[str, Figure]:
    """Return all figures by the names of their files."""
    register()
    towers = Towers()
    return {
        "task": task(towers),
        "twins": twins(towers),
        "cells": cells(towers),
        "seen_and_unseen": seen_and_unseen(towers),
    }


if __name__ == "__main__":
    for name, figure in figures().items():
        figure.savefig(HERE / f"{name}.png", dpi=110)
