"""Overviews of all runs: which methods on which splits, their MSE, epochs and seeds; and whether predictions tell twins apart."""

from collections.abc import Callable, Iterator
from functools import partial

import pandas as pd

from cophy.report.figures import row_name, sort_rows
from cophy.report.render import Cell
from cophy.report.runs import MISSING, POSITIONS, comparable_seeds

TWIN_METRICS = {
    "twin_difference_explained": "Explained part of the twins' difference",
    "right_twin_chosen": "Right twin chosen",
}
COLUMN = ["scenario", "split", "size", "positions"]  # what the runs of one column share, except for their epochs
TWINS_CAPTION = (
    "Twins share A, C and the do-operation and differ in their confounders, which only AB shows. Explained: "
    "1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|², with ΔP and ΔD the predicted and the true difference between twins; 0 % for any model "
    "without AB, 100 % for a perfect one. Right twin: how often P is nearer to its own D than to the twin's; 50 % by "
    "chance. [ ]: 95 % bootstrap interval over twin pairs; ±: standard deviation over seeds."
)


def twin_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return title -> rows × tested splits of `Cell`, for all runs that were tested on twins; empty without any.

    Args:
        runs: See `read_runs`.
    """
    if not set(TWIN_METRICS) <= set(runs.columns) or runs["right_twin_chosen"].isna().all():
        return {}
    tested = runs[runs["right_twin_chosen"].notna()]
    # methods without training, such as the copy baselines, are in the column of the longest training
    trained = tested["epochs"].where(tested["is_trained"].astype(bool))
    longest = trained.groupby([tested[name] for name in COLUMN]).transform("max")
    tested = tested.assign(epochs=trained.fillna(longest))
    tested = tested.assign(column=tested.apply(_column, axis=1))
    return {
        title: _wide(tested, "column", partial(_twin_cell, metric=metric)) for metric, title in TWIN_METRICS.items()
    }


def short_columns(columns: "pd.Index[str]") -> list[str]:
    """Return the columns of a table of one scenario, size and kind of positions without these, for the terminal."""
    splits = [column.split(" ", 1)[1] for column in columns]  # "3to3, small, 40 epochs, derendered"
    parts = [split.split(", ") for split in splits]
    alone = [part[0] for part in parts]
    if len(set(alone)) == len(alone):
        return alone
    return [", ".join([part[0], *(each for each in part[2:] if each.endswith("epochs"))]) for part in parts]


def _column(run: "pd.Series[str]") -> str:
    positions = "" if run["positions"] == "ground_truth" else f", {run['positions']}"
    epochs = "" if pd.isna(run["epochs"]) else f", {run['epochs']:.0f} epochs"
    return f"{run['scenario']} {run['split']}, {run['size']}{epochs}{positions}"


def _twin_cell(runs: pd.DataFrame, metric: str) -> Cell:
    runs = comparable_seeds(runs)
    value, low, high = (
        round(100 * runs[f"{metric}{end}"].mean(), 1) + 0.0 for end in ("", "_low", "_high")
    )  # no "-0.0"
    deviation = f"± {100 * runs[metric].std():.1f}" if len(runs) > 1 else ""
    return Cell(f"{value:.1f} %", deviation, f"[{low:.1f}, {high:.1f}]")


def overview_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return title -> rows × splits of `Cell` with MSE, epochs (where there was training) and number of seeds.

    Of trainings of several lengths, MSE and seeds are those of the longest.

    Args:
        runs: See `read_runs`.
    """
    return {title: _wide(group, "split", _overview_cell) for title, group in group_runs(runs)}


def group_runs(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield a title and the runs of each scenario, size and kind of positions."""
    if len(runs):
        for (scenario, size, positions), group in runs.groupby(["scenario", "size", "positions"]):
            yield f"{scenario}, size {size}, {POSITIONS[str(positions)]}", group


def _wide(runs: pd.DataFrame, column: str, cell: Callable[[pd.DataFrame], Cell]) -> pd.DataFrame:
    """Return rows × columns of the cells of the runs of each row and column."""
    rows = [row_name(model, ablation) for model, ablation in zip(runs["model"], runs["ablation"], strict=True)]
    named = runs.assign(row=rows)
    cells = {(str(row), str(name)): cell(group) for (row, name), group in named.groupby(["row", column])}
    columns = sorted({name for _, name in cells})
    return pd.DataFrame(
        {name: {row: cells.get((row, name), Cell(MISSING)) for row in sort_rows(set(rows))} for name in columns},
        dtype=object,
    )


def _overview_cell(runs: pd.DataFrame) -> Cell:
    finished = runs[runs["error"].isna()]
    failed = f"{len(runs) - len(finished)} failed"
    if finished.empty:
        return Cell(failed)
    lengths = sorted(finished.loc[finished["is_trained"].astype(bool), "epochs"].astype(int).unique())
    epochs = f"{', '.join(map(str, lengths))} " if lengths else ""
    seeds = comparable_seeds(finished)
    text = f"{seeds['mse'].mean():.3f} ({epochs}× {len(seeds)})"
    return Cell(text if len(finished) == len(runs) else f"{text}, {failed}")
