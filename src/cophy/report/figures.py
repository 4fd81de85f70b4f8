"""Figures of the report: predicted trajectories, error over time, tables as bars, and the stability distribution."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import compress
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cophy.drawing.plots import PALETTE, draw_error_over_time, draw_trajectories
from cophy.report.paper_tables import method_title
from cophy.report.predictions import StoredPredictions
from cophy.report.runs import comparable_seeds, largest_size
from cophy.report.tables import FilledTable
from cophy.scenario import Scenario
from cophy.scenario.towers import TOWER_CELLS

GREY, BLUE, ORANGE = "#b9bec6", *PALETTE[:2]
METRIC_LABELS = {"mse": "MSE (m²)", "pixel_error": "pixel error at 448 × 448 (pixels)"}  # others are shares in %
LINE_LENGTH = 14  # characters in a line of a panel's title, unless a word is longer
BAR_IN, CHARACTER_IN, MIN_WIDTH_IN = 0.42, 0.1, 6.4  # inches
LETTERS_PER_IN = 11  # of a figure's title


def draw_predictions(
    runs: pd.DataFrame,
    stored: Mapping[Path, StoredPredictions],
    scenarios: Mapping[str, Scenario],
    *,
    all_trajectories: bool,
) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure per scenario, split and positions: error over time of all rows, and predicted trajectories.

    Only runs of the largest size are drawn; a row shows its `comparable_seeds`. Rows that were tested on fewer experiments
    say so.

    Args:
        runs: Finished predictors, see `read_runs`.
        stored: Predictions of these runs by directory.
        all_trajectories: Whether trajectories of every row and split are drawn, or only those of CoPhyNet on the default
            split, from true positions.
    """
    for keys, tested in runs.groupby(["scenario", "split", "positions"]):
        group = largest_size(tested)
        name, split, positions = map(str, keys)
        scenario, curves, bands = scenarios[name], dict[str, np.ndarray](), dict[str, np.ndarray]()
        place = f"{name}-{split}" if positions == "ground_truth" else f"{name}-{split}-{positions}"
        title = (
            place.replace("-", ", ").replace("_", " ")
            + f"\nsize {group['size'].iloc[0]}, {group['num_test'].max():.0f} test experiments"
        )
        of_rows = {row_name(*map(str, keys)): runs for keys, runs in group.groupby(["model", "ablation"])}
        for row in sort_rows(of_rows):
            seeds = comparable_seeds(of_rows[row])
            count = seeds["num_test"].min()
            shown = "" if count == group["num_test"].max() else f"\n(first {count:.0f})"
            label = f"{row_title(row)}{shown}"
            predictions = [stored[directory] for directory in seeds["directory"]]
            curves[label] = np.mean([each.error_over_time for each in predictions], axis=0)
            bands[label] = np.mean([each.half_width for each in predictions], axis=0)
            if all_trajectories or (row, split, positions) == ("cophynet", scenario.task.splits[0], "ground_truth"):
                first = stored[seeds["directory"].iloc[0]].examples
                heading = f"{row_title(row)}, seed {seeds['seed'].iloc[0]}\n{title}"
                yield f"trajectories-{place}-{row.replace(' ', '-')}", _trajectories(first, scenario, heading)
        rate = scenario.clock.frame_rate_hz
        figure = draw_error_over_time(curves, frame_rate_hz=rate, title=title, half_widths=bands)
        yield f"error_over_time-{place}", figure


def _trajectories(examples: dict[str, np.ndarray], scenario: Scenario, title: str) -> Figure:
    arrays = [examples[key] for key in ("initial", "position", "target", "presence")]
    pairs = examples["pair"].tolist()
    are_twins = len(set(pairs)) < len(pairs)
    headings = [f"twin pair {pair}, twin {n}" for n, pair in enumerate(pairs, start=1)] if are_twins else []
    return draw_trajectories(*arrays, colors=list(scenario.colors.values()), title=title, headings=headings)


def row_name(model: str, ablation: str) -> str:
    """Return the name of a row in overviews and file names."""
    return model if ablation == "full" else f"{model} {ablation}"


def row_title(row: str) -> str:
    """Return the printed name of a row."""
    model, _, ablation = row.partition(" ")
    return method_title(model, ablation or "full")


def sort_rows(rows: Iterable[str]) -> list[str]:
    """Sort rows: models, then their ablations, so that a model has the same colour wherever all models are drawn."""
    return sorted(rows, key=lambda name: (" " in name, name))


def draw_bars(filled: FilledTable) -> Figure:
    """Draw the cells of a table that were run as bars: ours with interval or standard deviation, and the paper's."""
    table, values = filled.table, filled.values[filled.values["seeds"] > 0]
    groups, bars = ("column", "row") if table.methods_in == "rows" else ("row", "column")
    panels = {_wrap(str(label)): group for label, group in values.groupby(groups, sort=False)}
    longest = [max(map(len, label.split("\n"))) for label in panels]
    widths = [
        max(BAR_IN * len(group), CHARACTER_IN * length) for group, length in zip(panels.values(), longest, strict=True)
    ]
    figure = Figure(figsize=(max(MIN_WIDTH_IN, 1.8 + sum(widths)), 4.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False, width_ratios=widths)[0]
    for axis, (label, group) in zip(axes, panels.items(), strict=True):
        at = np.arange(len(group))
        has_sd = (group["seeds"] > 1) & group["sd"].notna()
        low, high = (np.where(has_sd, group["sd"], (group["ours"] - group[end]).abs()) for end in ("low", "high"))
        colors = [ORANGE if best else BLUE for best in group["best"]]
        axis.bar(at - 0.2, group["ours"], 0.4, color=colors, yerr=np.nan_to_num([low, high]), error_kw={"lw": 0.8})
        axis.bar(at + 0.2, group["paper"].astype(float).fillna(0), 0.4, color=GREY)
        axis.set_xticks(at, group[bars], rotation=60, ha="right", fontsize="small")
        axis.set_xlim(-0.6, len(group) - 0.4)
        axis.set_title(label, fontsize="medium")
        axis.grid(axis="y", alpha=0.2)
    metric = str(values["metric"].iloc[0])
    axes[0].set_ylabel(next((text for name, text in METRIC_LABELS.items() if metric.startswith(name)), "correct (%)"))
    legend = {"ours": BLUE, "ours, best": ORANGE, "the paper's": GREY}
    is_drawn = [True, values["best"].any(), values["paper"].notna().any()]
    handles = [Patch(color=color, label=label) for label, color in compress(legend.items(), is_drawn)]
    deviation = Line2D([], [], color="k", lw=0.8, label="sd over seeds; 95 % interval of one seed")
    figure.legend(handles=[*handles, deviation], loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    letters = int(LETTERS_PER_IN * figure.get_figwidth())
    figure.suptitle(fill(table.title, letters), fontsize="medium")
    return figure


def _wrap(label: str) -> str:
    """Break a panel's title into short lines; words stay whole."""
    return fill(label, LINE_LENGTH, break_long_words=False, break_on_hyphens=False)


EVEN_SHARE = (45, 55)  # %, in grey


def draw_stability_distribution(datasets: dict[int, dict[str, np.ndarray]]) -> Figure:
    """Draw the share of towers whose CD stands, for every value of each confounder (the paper's stability distribution).

    Masses and frictions: one combination per bar, blocks from the bottom up.

    Args:
        datasets: Number of blocks -> arrays of a dataset of towers.
    """
    figure = Figure(figsize=(15, 3.4 * len(datasets)), layout="constrained")
    axes = figure.subplots(len(datasets), 4, squeeze=False, sharey=True, width_ratios=[4, 4, 1, 1])
    standing = np.array([cell.counterfactual for cell in TOWER_CELLS])
    for row, (count, arrays) in zip(axes, sorted(datasets.items()), strict=True):
        for axis, (name, value) in zip(row, _values(arrays, count).items(), strict=True):
            share = 100 * pd.Series(standing[arrays["cell"]]).groupby(value).mean()
            at = np.arange(len(share))
            axis.bar(at, share, color=BLUE, label="CD stands")
            axis.bar(at, 100 - share, bottom=share, color=GREY, label="CD falls")
            axis.set_xticks(at, share.index)
            axis.axhspan(*EVEN_SHARE, color="k", alpha=0.12, lw=0)
            axis.set_title(f"{name}, K = {count}" if len(share) > 3 else name, fontsize="medium")
            axis.set_ylim(0, 100)
            axis.tick_params(axis="x", rotation=90 if len(share) > 3 else 0, labelsize="small")
        row[0].set_ylabel("experiments (%)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
    return figure


def _values(arrays: dict[str, np.ndarray], num_blocks: int) -> dict[str, np.ndarray]:
    """Return (experiment,) the value of each confounder as text."""
    height = np.where(arrays["presence"][:, 0], arrays["states"][:, 0, 0, :, 2], np.inf)
    blocks = height.argsort(axis=1)[:, :num_blocks]
    return {
        "mass (kg)": _combinations(np.take_along_axis(arrays["mass"], blocks, axis=1)),
        "friction": _combinations(np.take_along_axis(arrays["friction"], blocks, axis=1)),
        "gravity x (m/s²)": _combinations(arrays["gravity"][:, :1]),
        "gravity y (m/s²)": _combinations(arrays["gravity"][:, 1:2]),
    }


def _combinations(values: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{value:g}" for value in row) for row in values])
