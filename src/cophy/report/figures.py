"""Figures of runs and tables: predictions, error over time, tables as bars."""

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.drawing.plots import draw_error_over_time, draw_trajectories, error_over_time
from cophy.report.colors import BLUE, GREY, RED
from cophy.report.runs.comparable import of_largest_size, of_seeds
from cophy.report.tables.filled_tables import FilledTable
from cophy.scenario import Scenario
from cophy.training.runs.results import read_predictions

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
