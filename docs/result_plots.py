"""The plots of results.csv. A PNG holds a digest of its numbers, so that a check finds a plot of other numbers."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import astuple, is_dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter
from PIL import Image
from result_runs import COLUMNS, CURVE_METHODS, CURVES, SCENARIOS, Results, title

Data = list[dict[str, Any]]

DIGEST = "Digest of data"
STYLES = {  # marker, colour, and shift within a group of the leaderboard
    "copy_b": ("x", "#888888", 0),
    "trees": ("P", "#7a7a3a", -0.24),
    "in": ("v", "#56a0d3", 0.24),
    "cophynet": ("o", "#0b4f8a", -0.08),
    "transformer": ("*", "#d98a1f", 0.08),
    "alongside": ("D", "#c8442c", 0),
    "in_sup": ("s", "#3f9f5f", 0.16),
}
BETWEEN_ORACLES = ("copy_b", "in", "cophynet", "alongside", "oracle_feedforward", "oracle_counterfactual")
SPACING = {"blocktower": 1.0, "balls": 1.0, "collision": 1.8}  # of the columns: collisions have long names
COSTS = {  # methods that train a network, with their colours
    **{name: color for name, (_, color, _) in STYLES.items() if name not in ("copy_b", "trees")},
    **{"npe": "#b8a000", "cophynet_adam": "#6f9fd0", "cophynet_canonical": "#123a5f", "gns": "#8a4fbf"},
    **{"alongside_canonical": "#8f2f1a", "alongside_posed": "#c0a080", "hypotheses": "#e8907c"},
}
MEASURES = {
    "mse": ("test MSE, m²", 1),
    "share": ("share of the possible gain, %", 100),
    "twin_difference_explained": ("twin difference explained, %", 100),
}


def digest(data: Data) -> str:
    """Return a digest of the numbers and names in a plot, and of the code that draws it."""
    names = [SCENARIOS, {method: title(method) for method in {**STYLES, **COSTS}}]
    text = json.dumps([data, names], default=lambda value: astuple(value) if is_dataclass(value) else str(value))
    return hashlib.sha256((text + Path(__file__).read_text()).encode()).hexdigest()[:16]


def is_of(path: Path, data: Data) -> bool:
    """Whether a picture shows these numbers."""
    if not path.exists():
        return False
    with Image.open(path) as picture:
        return bool(picture.info.get(DIGEST) == digest(data))


def save(figure: Figure, path: Path, data: Data) -> None:
    """Write a picture of these numbers."""
    figure.savefig(path, dpi=120, metadata={DIGEST: digest(data), "Software": None})
    plt.close(figure)


def relative_to_copy_c(results: Results) -> Data:
    """Return the MSE of every method and column, divided by that of copy C; NaN where there is no run."""
    lines = []
    for scenario, split, label in COLUMNS:
        copy_c = results.cell("mse", scenario, split, "copy_c")
        for method in STYLES:
            cell = results.cell("mse", scenario, split, method)
            ratio = round(cell.value / copy_c.value, 6) if cell and copy_c else float("nan")
            lines.append({"scenario": scenario, "label": label, "method": method, "ratio": ratio})
    return lines


def draw_leaderboard(data: Data) -> Figure:
    """A group per column, a marker per method; 1 is copy C."""
    figure, axis = plt.subplots(figsize=(8, 4.2), layout="constrained")
    places, last = [], 0.0
    for (scenario, _, _), (before, _, _) in zip(COLUMNS, [COLUMNS[0], *COLUMNS], strict=False):
        last += SPACING[scenario] + 0.6 * (scenario != before)
        places.append(last)
    for method, (marker, color, shift) in STYLES.items():
        ratios = [point["ratio"] for point in data if point["method"] == method]
        axis.plot([place + shift for place in places], ratios, marker, color=color, markersize=7, label=title(method))
    for place, (scenario, _, label) in zip(places, COLUMNS, strict=True):
        ratios = [point["ratio"] for point in data if (point["scenario"], point["label"]) == (scenario, label)]
        axis.plot([place, place], [np.nanmin(ratios), np.nanmax(ratios)], color="#dddddd", linewidth=1, zorder=0)
    axis.axhline(1, color="black", linewidth=1)
    axis.text(1.005, 1, "copy C", transform=axis.get_yaxis_transform(), va="center", fontsize=10)
    axis.set(yscale="log", ylabel="test MSE ÷ MSE of copy C", ylim=(0.009, 2.2), xlim=(0.3, places[-1] + 0.7))
    ticks = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1)
    axis.yaxis.set_major_locator(FixedLocator(ticks))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(axis="y", which="minor", left=False)
    axis.set_xticks(places, [label.replace("→c", "→\nc").replace("→s", "→\ns") for _, _, label in COLUMNS], fontsize=9)
    for name in SCENARIOS:
        group = [place for place, (scenario, _, _) in zip(places, COLUMNS, strict=True) if scenario == name]
        axis.text(sum(group) / len(group), 1.75, SCENARIOS[name], ha="center", fontsize=11, weight="bold")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=10, handletextpad=0.1, columnspacing=1.2)
    return figure


def draw_learning_curves(data: Data) -> Figure:
    """A row of panels per scenario, a panel per measure; bands are 95 % intervals."""
    figure, axes = plt.subplots(len(SCENARIOS), len(MEASURES), figsize=(8, 7.5), layout="constrained", sharex="row")
    for row, (scenario, name) in zip(axes, SCENARIOS.items(), strict=True):
        for axis, (measure, (label, scale)) in zip(row, MEASURES.items(), strict=True):
            for method in CURVE_METHODS:
                marker, color, _ = STYLES[method]
                named = [point for point in data if (point["scenario"], point["method"]) == (scenario, method)]
                curve = [point for point in named if point[measure]]
                counts, cells = [point["num_train"] for point in curve], [point[measure] for point in curve]
                axis.plot(
                    counts,
                    [scale * cell.value for cell in cells],
                    marker,
                    ls="-",
                    color=color,
                    label=title(method),
                    ms=5,
                )
                ends = [[scale * getattr(cell, end) for cell in cells] for end in ("low", "high")]
                axis.fill_between(counts, *ends, color=color, alpha=0.15)
            axis.set(xscale="log", yscale="log" if measure == "mse" else "linear")
            shown = {point["num_train"] for point in data if point["scenario"] == scenario}
            axis.xaxis.set_major_locator(FixedLocator(sorted(shown)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick / 1000:.3g}k"))
            axis.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
            axis.minorticks_off()
            if measure == "mse":
                axis.yaxis.set_major_locator(FixedLocator([0.03, 0.1, 0.2, 0.3, 0.5, 1, 2, 4]))
            axis.tick_params(labelsize=9)
            axis.set_title(label if scenario == "blocktower" else "", fontsize=10)
        row[0].set_ylabel(name, fontsize=11, weight="bold")
    axes[-1][1].set_xlabel("training experiments")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def between_oracles(results: Results) -> Data:
    """Return MSE and share of the possible gain of methods on collisions, the highest MSE first."""
    lines = []
    for method in BETWEEN_ORACLES:
        cells = {measure: results.cell(measure, "collision", "all", method) for measure in ("mse", "share")}
        (run, *_) = results.of("collision", "all", method)
        values = {measure: round(cell.value, 6) for measure, cell in cells.items() if cell}
        lines.append({"title": title(method), "tests": int(run["num_test"])} | values)
    return sorted(lines, key=lambda line: -line["mse"])


def draw_oracles(data: Data) -> Figure:
    """Draw the MSE of collisions as bars between those of the two oracles."""
    figure = plt.figure(figsize=(7.6, 3.4))
    axis = figure.add_axes((0.225, 0.17, 0.52, 0.6))
    colors = ["#c9b6e4" if "oracle" in line["title"] else "#a9c8ea" for line in data]
    axis.barh([line["title"] for line in data], [line["mse"] for line in data], color=colors)
    right = {"ha": "right", "fontsize": 12}
    for row, line in enumerate(data):
        share = f"{100 * line['share']:.0f} %"
        axis.text(line["mse"] + 0.008, row, f"{line['mse']:.3f}", va="center", fontsize=12)
        axis.text(1.26, row, share, va="center", transform=axis.get_yaxis_transform(), **right)
    axis.text(1.29, 1.04, "share of the\npossible gain", transform=axis.transAxes, **right)
    mse = {line["title"]: line["mse"] for line in data}
    for name, text in (("oracle with AB", "best with AB"), ("oracle without AB", "best without AB")):
        axis.axvline(mse[name], color="0.35", ls=":", zorder=0)
        at = (mse[name], 1.04)
        axis.annotate(text, at, xycoords=axis.get_xaxis_transform(), ha="center", fontsize=12, color="0.35")
    tests = [line["tests"] for line in data]
    heading = f"Collisions, size=small: {max(tests):,} test experiments, {min(tests):,} of them for oracles"
    figure.text(0.5, 0.955, heading, ha="center", va="center", fontsize=12)
    axis.set_xlabel("MSE of D (m²), mean over seeds; lower is better", fontsize=12)
    axis.set(xlim=(0, 0.95))
    axis.tick_params(labelsize=12)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def cost_and_error(results: Results) -> Data:
    """Return the median CPU time and the mean MSE of the trained methods of size=small over their training seeds."""
    points = []
    for scenario, split in CURVES.items():
        for method in COSTS:
            minutes, mse = results.cpu_minutes(scenario, split, method), results.cell("mse", scenario, split, method)
            if minutes and mse:
                points.append({"scenario": scenario, "method": method, "minutes": minutes, "mse": mse.value})
    return points


def draw_cost(data: Data) -> Figure:
    """A panel per scenario, a point per method."""
    scenarios = list(dict.fromkeys(point["scenario"] for point in data))
    shown = {method: color for method, color in COSTS.items() if method in {point["method"] for point in data}}
    figure, axes = plt.subplots(
        1, len(scenarios), figsize=(max(7, 4 * len(scenarios)), 3.8), layout="constrained", squeeze=False
    )
    for axis, scenario in zip(axes[0], scenarios, strict=True):
        for method, color in shown.items():
            points = [point for point in data if (point["scenario"], point["method"]) == (scenario, method)]
            marker = STYLES[method][0] if method in STYLES else "P"
            values = ([point[name] for point in points] for name in ("minutes", "mse"))
            axis.plot(*values, marker, color=color, ls="", label=title(method), ms=6)
        axis.set(
            xscale="log", yscale="log", xlabel="CPU time of a training, minutes (median)", ylabel="test MSE, m² (mean)"
        )
        for each in (axis.xaxis, axis.yaxis):
            each.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
            each.set_minor_formatter(NullFormatter())
            each.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        axis.tick_params(which="both", labelsize=9)
        axis.set_title(SCENARIOS[scenario], fontsize=11)
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=9
    )
    return figure


PLOTS: dict[str, tuple[Callable[[Results], Data], Callable[[Data], Figure]]] = {
    "leaderboard": (relative_to_copy_c, draw_leaderboard),
    "oracles": (between_oracles, draw_oracles),
    "learning_curves": (Results.learning_curves, draw_learning_curves),
    "cost": (cost_and_error, draw_cost),
}
