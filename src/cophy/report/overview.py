"""Overviews of all runs as text: MSE, epochs and seeds; how well predictions separate twins; cost and all metrics."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pandas as pd

from cophy.report.figures import row_name, sort_rows
from cophy.report.render import Cell
from cophy.report.runs import MISSING, PLACE, POSITIONS, comparable_seeds

TWIN_METRICS = {
    "twin_difference_explained": "Explained part of the twins' difference",
    "right_twin_chosen": "Right twin chosen",
}
TWINS_CAPTION = (
    "Twins share A, C and the do-operation and differ in their confounders, which only AB shows. Explained: "
    "1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|², with ΔP and ΔD the predicted and the true difference between twins; 0 % for any model "
    "without AB, 100 % for a perfect one. Right twin: how often P is nearer to its own D than to the twin's; 50 % by "
    "chance. [ ]: 95 % bootstrap interval over clusters; ±: standard deviation over seeds."
)


def twin_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return title -> rows × tested splits of `Cell`, for all runs that were tested on twins; empty without any.

    Of trainings of several lengths, the longest is shown.

    Args:
        runs: See `read_runs`.
    """
    if not {f"metrics.{name}" for name in TWIN_METRICS} <= set(runs.columns):
        return {}
    return {
        f"{title}: {kind}": _wide(group, partial(_twin_cell, metric=metric))
        for kind, group in group_runs(runs[runs[[f"metrics.{name}" for name in TWIN_METRICS]].notna().all(axis=1)])
        for metric, title in TWIN_METRICS.items()
    }


def _twin_cell(runs: pd.DataFrame, metric: str) -> Cell:
    seeds = comparable_seeds(runs)
    means = (100 * seeds[f"{column}.{metric}"].mean() for column in ("metrics", "low", "high"))
    value, low, high = (round(percent, 1) + 0.0 for percent in means)  # no "-0.0"
    deviation = f"± {100 * seeds[f'metrics.{metric}'].std():.1f}" if len(seeds) > 1 else ""
    return Cell(f"{value:.1f} %", deviation, f"[{low:.1f}, {high:.1f}]")


def overview_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return title -> rows × splits of `Cell` with MSE, epochs (where there was training) and number of seeds.

    Of trainings of several lengths, MSE and seeds are those of the longest.

    Args:
        runs: See `read_runs`.
    """
    return {title: _wide(group, _overview_cell) for title, group in group_runs(runs)}


def group_runs(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield a title and the runs of each scenario, size and kind of positions."""
    if len(runs):
        for (scenario, size, positions), group in runs.groupby(["scenario", "size", "positions"]):
            yield f"{scenario}, size {size}, {POSITIONS[str(positions)]}", group


def _wide(runs: pd.DataFrame, cell: Callable[[pd.DataFrame], Cell]) -> pd.DataFrame:
    """Return rows × splits of the cells of the runs of each row and split."""
    rows = [row_name(model, ablation) for model, ablation in zip(runs["model"], runs["ablation"], strict=True)]
    cells = pd.Series({key: cell(group) for key, group in runs.groupby([np.array(rows), "split"])}, dtype=object)
    return cells.unstack(fill_value=Cell(MISSING)).loc[sort_rows(set(rows))]  # type: ignore[arg-type]  # any object


def _overview_cell(runs: pd.DataFrame) -> Cell:
    finished = runs[runs["error"].isna()]
    failed = f"{len(runs) - len(finished)} failed"
    if finished.empty:
        return Cell(failed)
    lengths = sorted(finished.loc[finished["is_trained"].astype(bool), "epochs"].astype(int).unique())
    epochs = f"{', '.join(map(str, lengths))} " if lengths else ""
    seeds = comparable_seeds(finished)
    text = f"{seeds['metrics.mse'].mean():.3f} ({epochs}× {len(seeds)})"
    return Cell(text if len(finished) == len(runs) else f"{text}, {failed}")


def summarize_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return cost and test metrics of all runs as text: means over seeds, ± standard deviation where there are several.

    Trainings of other lengths, or with other de-renderers, have lines of their own.
    """
    if runs.empty:
        return runs
    names, separate = [*PLACE, "size"], [name for name in ("epochs", "derenderer") if name in runs]
    metrics = [column for column in runs.columns if column.startswith("metrics.")]
    known = (
        runs.astype(dict.fromkeys(separate, object))
        .fillna(dict.fromkeys(separate, MISSING))
        .assign(failed=runs["error"].notna())
    )
    groups = known.groupby([*names, *separate])
    summary = groups.size().rename("runs").reset_index()
    failed, means, deviations = groups["failed"].sum().to_numpy(), groups[metrics].mean(), groups[metrics].std()
    table = pd.DataFrame({"run": summary[names].agg(" ".join, axis=1)})
    table["seeds"] = [
        f"{count - lost}" + (f" ({lost} failed)" if lost else "")
        for count, lost in zip(summary["runs"], failed, strict=True)
    ]
    for name in separate:
        table[name] = summary[name].map(_as_text)
    if "training_seconds" in runs:
        seconds = (
            known["training_seconds"]
            .where(known["predictor"].isna())
            .groupby([known[name] for name in (*names, *separate)])
        )
        table["training (s)"] = seconds.mean().map(_as_text).to_numpy()
    for metric in metrics:
        pairs = zip(means[metric], deviations[metric], strict=True)
        table[metric.removeprefix("metrics.").replace("_", " ")] = [
            _mean_and_deviation(mean, deviation) for mean, deviation in pairs
        ]
    return table


def _as_text(value: str | float) -> str:
    return value if isinstance(value, str) else MISSING if pd.isna(value) else f"{value:.0f}"


def _mean_and_deviation(mean: float, deviation: float) -> str:
    """Return a mean and its standard deviation, which is NaN for one value, as text."""
    if pd.isna(mean):
        return MISSING
    return f"{mean:.3f}" if pd.isna(deviation) else f"{mean:.3f} ± {deviation:.3f}"
