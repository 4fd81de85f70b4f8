"""Share of towers whose CD stands, for every value of each confounder (the paper's stability distribution).

Colours of the report's figures.
Figures of runs and tables: predictions, error over time, tables as bars.
"""

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.drawing.plots import draw_error_over_time, draw_trajectories, error_over_time
from cophy.report.runs import of_largest_size, of_seeds
from cophy.report.tables import FilledTable
from cophy.scenario import Scenario
from cophy.scenario.towers import TOWER_CELLS
from cophy.training.run import read_predictions

GREY, BLUE, RED = "#b9bec6", "#2b6fd6", "#d1342f"


NUM_SHOWN = 2  # experiments: a twin pair, which shares C but not D
CHARACTERS = 14  # of a line of a panel's title, unless a word is longer
BAR_IN, CHARACTER_IN, MIN_WIDTH_IN = 0.42, 0.1, 6.4  # inches


def write_figure(directory: Path, name: str, figure: Figure) -> None:
    """Write a figure as PNG and as PDF.

    Args:
        directory: Where they go.
        name: Of the files, without an ending.
        figure: Is not laid out again after that.
    """
    for kind, options in (("png", {"dpi": 110}), ("pdf", {"metadata": {"CreationDate": None}})):
        picture = io.BytesIO()
        figure.savefig(picture, format=kind, **options)
        figure.set_layout_engine("none")  # as it lies now
        write_atomically(directory / f"{name}.{kind}", picture.getvalue())


def of_predictions(runs: pd.DataFrame, scenarios: Mapping[str, Scenario]) -> Iterator[tuple[str, Figure]]:
    """Per scenario and split: the trajectories that each model predicts, and every model's error over time.

    Of the largest size alone. Of a row, those of `of_seeds` count. Rows that were asked about fewer experiments say so.
    """
    predicted = runs[~runs["model"].str.startswith("derenderer")]
    for keys, tested in predicted.groupby(["scenario", "split", "positions"]):
        found = of_largest_size(tested)
        most = found["num_test"].max()
        name, split, positions = (str(key) for key in keys)
        scenario, curves = scenarios[name], {}
        group = f"{name}-{split}" if positions == "ground_truth" else f"{name}-{split}-{positions}"
        title = group.replace("-", ", ").replace("_", " ") + ", test split"
        for (model, ablation), of_row in found.groupby(["model", "ablation"]):
            seeds = of_seeds(of_row)
            each = [read_predictions(directory) for directory in seeds["directory"]]
            dims, row = scenario.task.metric_dims, row_name(str(model), str(ablation))
            errors = [error_over_time(p["position"], p["target"], p["presence"], dims=dims) for p in each]
            asked = seeds["num_test"].min()
            curves[row if asked == most else f"{row} (first {asked:.0f})"] = np.mean(errors, axis=0)
            seed = seeds["seed"].iloc[0]
            yield (
                f"trajectories-{group}-{row.replace(' ', '-')}",
                _trajectories(each[0], scenario, f"{row}, seed {seed}\n{title}"),
            )
        ordered = {model: curves[model] for model in in_order(curves)}
        rate = scenario.clock.frame_rate_hz
        yield f"error_over_time-{group}", draw_error_over_time(ordered, frame_rate_hz=rate, title=title)


def _trajectories(predictions: dict[str, np.ndarray], scenario: Scenario, title: str) -> Figure:
    """What a run predicts of the first test experiments."""
    shown = [predictions[key][:NUM_SHOWN] for key in ("initial", "position", "target", "presence")]
    pairs = predictions["pair"][:NUM_SHOWN].tolist()
    are_twins = len(set(pairs)) < len(pairs)
    headings = [f"twin pair {pair}, twin {n}" for n, pair in enumerate(pairs, start=1)] if are_twins else []
    colors = list(scenario.colors.values())
    return draw_trajectories(*shown, colors=colors, title=title, headings=headings)


def row_name(model: str, ablation: str) -> str:
    """What a row of a table is called in figures."""
    return model if ablation == "full" else f"{model} {ablation}"


def in_order(rows: Iterable[str]) -> list[str]:
    """Rows as figures colour them: models, then their ablations, so that a model looks the same wherever all models are."""
    return sorted(rows, key=lambda name: (" " in name, name))


def draw_bars(filled: FilledTable) -> Figure:
    """The cells of a table that were run, as bars: ours with interval or standard deviation, the paper's in grey."""
    table, values = filled.table, filled.values[filled.values["seeds"] > 0]
    groups, bars = ("column", "row") if table.methods == "rows" else ("row", "column")
    panels = {_in_lines(str(label)): group for label, group in values.groupby(groups, sort=False)}
    longest = [max(map(len, label.split("\n"))) for label in panels]
    widths = [
        max(BAR_IN * len(group), CHARACTER_IN * length) for group, length in zip(panels.values(), longest, strict=True)
    ]
    figure = Figure(figsize=(max(MIN_WIDTH_IN, 1.8 + sum(widths)), 4.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False, width_ratios=widths)[0]
    for axis, (label, group) in zip(axes, panels.items(), strict=True):
        at = np.arange(len(group))
        low, high = (
            np.where(group["seeds"] > 1, group["sd"], (group["ours"] - group[end]).abs()) for end in ("low", "high")
        )
        colors = [RED if best else BLUE for best in group["best"]]
        axis.bar(at - 0.2, group["ours"], 0.4, color=colors, yerr=np.nan_to_num([low, high]), error_kw={"lw": 0.8})
        axis.bar(at + 0.2, group["paper"].astype(float).fillna(0), 0.4, color=GREY)
        axis.set_xticks(at, group[bars], rotation=60, ha="right", fontsize="small")
        axis.set_xlim(-0.6, len(group) - 0.4)
        axis.set_title(label, fontsize="medium")
        axis.grid(axis="y", alpha=0.2)
    axes[0].set_ylabel(fill(table.title.split(":")[-1].strip(), 50), fontsize="small")
    figure.suptitle(f"{table.title.split(':')[0]}: ours (blue, best red), the paper's (grey)", fontsize="medium")
    return figure


def _in_lines(label: str) -> str:
    """A panel's title in short lines; words stay whole."""
    return fill(label, CHARACTERS, break_long_words=False, break_on_hyphens=False)


EVEN_SHARE = (45, 55)  # %, in grey


def draw_stability_distribution(datasets: dict[int, dict[str, np.ndarray]]) -> Figure:
    """Bars per value. Masses and frictions: one combination per bar, blocks from the bottom up.

    datasets: towers, arrays per number of blocks.
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
        row[0].set_ylabel("experiments, %")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
    return figure


def _values(arrays: dict[str, np.ndarray], num_blocks: int) -> dict[str, np.ndarray]:
    """(experiment,) what each confounder is, as text."""
    height = np.where(arrays["presence"][:, 0], arrays["states"][:, 0, 0, :, 2], np.inf)
    blocks = height.argsort(axis=1)[:, :num_blocks]
    return {
        "mass, kg": _combinations(np.take_along_axis(arrays["mass"], blocks, axis=1)),
        "friction": _combinations(np.take_along_axis(arrays["friction"], blocks, axis=1)),
        "gravity x, m/s²": _combinations(arrays["gravity"][:, :1]),
        "gravity y, m/s²": _combinations(arrays["gravity"][:, 1:2]),
    }


def _combinations(values: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{value:g}" for value in row) for row in values])
