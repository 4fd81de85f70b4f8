"""Figures of predictions, for TensorBoard and the report."""

import io
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cophy.atomic_files import write_atomically
from cophy.scenario import Camera

VIEWS = {"from above": (0, 1), "from the side": (0, 2)}  # the axes shown
FRAMES_PER_MARKER = 4
MIN_VIEW_M = 2.0  # keeps tiny movements from filling the figure
LEGEND_LETTERS = 18  # in a line of a legend next to a figure
LEGEND_LINE_INCHES, LEGEND_GAP_INCHES = 0.16, 0.08  # of such a legend: height of a line, and between two entries
MIN_HEIGHT_CHANGE_M = 0.05  # of an object, for a view from the side
# Okabe and Ito, without yellow: distinct for the colour-blind
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
LINES, MARKERS = ("-", "--", ":", "-."), "osD^"


def style(n: int) -> dict[str, Any]:
    """Return colour, line and marker of the n-th line of a figure."""
    repeat = n // len(PALETTE) % len(LINES)
    return {"color": PALETTE[n % len(PALETTE)], "linestyle": LINES[repeat], "marker": MARKERS[repeat]}


for name in ("fontTools", "matplotlib.font_manager"):  # a line per table of each font
    logging.getLogger(name).setLevel(logging.WARNING)


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG and vector PDF with text as text, in the same layout.

    Args:
        path: The path without a suffix.
        figure: Its layout is fixed afterwards.
    """
    if engine := figure.get_layout_engine():
        engine.execute(figure)
        figure.set_layout_engine(None)  # savefig would compute it again for each file
    for kind, options in (("png", {"dpi": 110}), ("pdf", {"metadata": {"CreationDate": None}})):
        file = io.BytesIO()
        with rc_context({"pdf.fonttype": 42}):  # TrueType: text stays text
            figure.savefig(file, format=kind, **options)
        write_atomically(path.with_name(f"{path.name}.{kind}"), file.getvalue())


def square_root(values: np.ndarray) -> np.ndarray:
    """Return the square root, and 0 below 0: the scale of an axis, importable by the processes that write figures."""
    return np.asarray(np.sqrt(np.maximum(values, 0)))


def draw_trajectories(
    initial: np.ndarray,
    predicted: np.ndarray,
    true: np.ndarray,
    presence: np.ndarray,
    *,
    colors: Sequence[str],
    title: str = "",
    headings: Sequence[str] = (),
) -> Figure:
    """Draw predicted and true trajectories of a few experiments, each object in its colour, from above.

    If an object rises or falls, they are also drawn from the side.

    Squares are C, circles the truth, crosses the prediction (as in the paper's figure of predictions), at every fourth
    frame and the last. Twins, which share C, have the same axis limits.

    Args:
        initial: (N, K, 3) positions in C, metres.
        predicted: (N, T-1, K, 3) in D.
        true: (N, T-1, K, 3) in D.
        presence: (N, K) which slots hold an object.
        headings: one for each experiment, or none.
    """
    count, heights = len(initial), np.concatenate([initial[:, None], true], axis=1)[..., 2]
    is_flat = (np.ptp(heights, axis=1)[presence] < MIN_HEIGHT_CHANGE_M).all()
    views = list(VIEWS.items())[: 1 if is_flat else None]
    height = 3.0 * len(views) + 0.6 + 0.2 * len(title.splitlines())
    figure = Figure(figsize=(3.0 * count, height), layout=ConstrainedLayoutEngine(h_pad=0.08))  # inches
    figure.suptitle(title, fontsize="medium")
    axes = figure.subplots(len(views), count, squeeze=False)
    for (view, (right, up)), row, titles in zip(views, axes, (headings, ()), strict=False):
        for n, axis in enumerate(row):
            for slot in np.flatnonzero(presence[n]).tolist():
                style = {"color": colors[slot], "markerfacecolor": "none"}
                for path, marker, line in ((true[n, :, slot], "o", "-"), (predicted[n, :, slot], "x", ":")):
                    trajectory = np.concatenate([initial[n, None, slot], path])[:, [right, up]]
                    marked = [*range(FRAMES_PER_MARKER, len(trajectory) - 1, FRAMES_PER_MARKER), len(trajectory) - 1]
                    axis.plot(*trajectory.T, line, marker=marker, markevery=marked, ms=6, lw=0.8, **style)
                axis.plot(*initial[n, slot, [right, up]], "s", ms=9, **style)
            twins = [m for m in range(count) if np.array_equal(initial[m], initial[n])]
            paths = [path[m][:, presence[m]] for m in twins for path in (initial[:, None], true, predicted)]
            points = np.concatenate([path[..., [right, up]].reshape(-1, 2) for path in paths])
            low, high = points.min(axis=0), points.max(axis=0)
            centre, half = (low + high) / 2, 0.55 * max((high - low).max(), MIN_VIEW_M)
            axis.set(
                xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half), aspect="equal"
            )
            prefix = f"{view}\n" if n == 0 else ""
            axis.set(xlabel="x (m)", ylabel=f"{prefix}{'xyz'[up]} (m)")
            axis.set_title(titles[n] if titles else "", fontsize="medium")
            axis.locator_params(nbins=4)
            axis.grid(alpha=0.2)
    marks = (("s", "", "C"), ("o", "-", "true D"), ("x", ":", "predicted D"))
    handles = [
        Line2D([], [], color="0.3", marker=m, ls=ls, markerfacecolor="none", label=name) for m, ls, name in marks
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def draw_centres(
    images: np.ndarray,
    predicted: np.ndarray,
    predicted_presence: np.ndarray,
    true: np.ndarray,
    presence: np.ndarray,
    *,
    camera: Camera,
) -> Figure:
    """Draw frames with true (circles) and predicted (crosses) centres.

    Args:
        images: (N, R, R, 3) uint8.
        predicted: (N, K, 3) positions, metres.
        predicted_presence: (N, K) which slots are predicted to hold an object.
        true: (N, K, 3) positions, metres.
        presence: (N, K) which slots hold an object.
    """
    columns = min(len(images), 4)
    rows = -(-len(images) // columns)
    figure = Figure(figsize=(3.0 * columns, 3.0 * rows), layout="constrained")
    for axis, image, *what in zip(
        figure.subplots(rows, columns, squeeze=False).flat,
        images,
        true,
        presence,
        predicted,
        predicted_presence,
        strict=False,
    ):
        axis.imshow(image)
        for position, present, marker in ((what[0], what[1], "o"), (what[2], what[3], "x")):
            x, y = camera.project(position[present], len(image)).T - 0.5
            axis.plot(
                x, y, marker, color="white", markeredgecolor="black" if marker == "o" else "white", ms=7, mfc="none"
            )
        axis.set_axis_off()
    return figure


def error_over_time(predicted: np.ndarray, true: np.ndarray, presence: np.ndarray, *, dims: int) -> np.ndarray:
    """Return the position error of each experiment at every step: the mean over present objects.

    Args:
        predicted: (N, T-1, K, 3) positions in D, metres.
        true: (N, T-1, K, 3) true positions.
        presence: (N, K) which slots hold an object.
        dims: number of coordinates that count.

    Returns:
        (N, T-1) Euclidean distance, metres.
    """
    distance = np.linalg.norm((predicted - true)[..., :dims], axis=-1)
    return np.asarray((distance * presence[:, None]).sum(axis=-1) / presence.sum(axis=-1)[:, None])


def draw_error_over_time(
    curves: Mapping[str, np.ndarray],
    *,
    frame_rate_hz: float,
    title: str = "",
    half_widths: Mapping[str, np.ndarray] | None = None,
) -> Figure:
    """Draw the mean position error of each model over time as a line; the legend starts with the largest final error.

    Args:
        curves: (T-1,) errors of each model, m.
        half_widths: (T-1,) half of the 95 % interval over clusters, m, drawn as a band unless it is NaN.
    """
    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axis, lines = figure.subplots(), []
    bands = {name: width for name, width in (half_widths or {}).items() if not np.isnan(width).any()}
    for n, (name, curve) in enumerate(curves.items()):
        time, look = (1 + np.arange(len(curve))) / frame_rate_hz, style(n)
        lines += axis.plot(
            time, curve, look["linestyle"], color=look["color"], label=fill(name, LEGEND_LETTERS), lw=1.5
        )
        if name in bands:
            axis.fill_between(time, curve - bands[name], curve + bands[name], color=look["color"], alpha=0.15, lw=0)
    axis.set(xlabel="time (s)", ylabel="position error (m)", title=title, xlim=(0, None), ylim=(0, None))
    axis.title.set_fontsize("medium")
    axis.grid(alpha=0.2)
    handles: list[Any] = sorted(lines, key=lambda line: -float(np.asarray(line.get_ydata())[-1]))
    band = [Patch(color="0.8", label="95 % interval\nover clusters")] if bands else []
    if len(curves) > 1 or bands:
        handles += band
        num_lines = sum(1 + str(handle.get_label()).count("\n") for handle in handles)
        figure.set_figheight(
            max(figure.get_figheight(), LEGEND_LINE_INCHES * num_lines + LEGEND_GAP_INCHES * len(handles))
        )
        figure.legend(handles=handles, loc="outside right center", frameon=False, fontsize="small")
    return figure


def draw_confusion(counts: np.ndarray, names: Sequence[str]) -> Figure:
    """Draw how often each outcome was predicted for each true one, with its share of the row.

    Args:
        counts: (C, C) experiments; rows are true outcomes, columns predicted ones.
        names: names of the outcomes.
    """
    figure = Figure(figsize=(4.2, 3.6), layout="constrained")
    axis = figure.subplots()
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axis.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for (row, column), share in np.ndenumerate(shares):
        text = f"{int(counts[row, column])}\n{share:.0%}"
        axis.text(column, row, text, ha="center", va="center", color="white" if share > 0.5 else "black")
    axis.set_xticks(range(len(names)), names)
    axis.set_yticks(range(len(names)), names)
    axis.set(xlabel="predicted", ylabel="true", title="Towers of CD: count, share of the row")
    return figure
