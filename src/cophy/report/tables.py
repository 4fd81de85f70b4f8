"""The paper's tables filled with our numbers: one line per cell, in the table's own unit.

Nothing is formatted here; `cophy.report.render` does that, once per medium.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.bootstrap import Ratio, interval
from cophy.report.paper_tables import PaperTable
from cophy.report.runs import PLACE, comparable_seeds, select
from cophy.scoring import Scores, average, have_same_experiments

TESTED_ON = {  # positions= -> sentence of the caption
    "ground_truth": "Tested on true positions.",
    "derendered": "Trained and tested on positions estimated from images.",
    "train_ground_truth_test_derendered": "Tested on positions estimated from images.",
}

PAPER_SIZES = {
    "paper",
    "cophy",
}  # sizes with the paper's number of experiments: only their best is in bold next to its numbers
ORACLES_NOTE = (
    "Oracles simulate (docs/benchmark/metrics.md). They know what A and C show at t = 0 beyond positions: object type and pose. "
    "A network sees these only with model.object_type=true and model.pose=true. "
    "For Monte Carlo oracles, the sampling variance is subtracted from squared errors."
)


def _caption(table: PaperTable, used: pd.DataFrame) -> str:
    """Return the caption of a table that these runs fill, without its controls."""
    better = "Lower" if table.lower_is_better else "Higher"
    notes = [f"Ours, then the paper's number. {better} is better."]
    if used.empty:
        return " ".join([*notes, "Nothing was run yet."])
    num_train, num_test, seeds = (_listed(used[name]) for name in ("num_train", "num_test", "seed"))
    trained = used[used["is_trained"].astype(bool)]  # copies and oracles have a number of epochs, too
    epochs = "" if trained.empty else f" {_listed(trained['epochs'])} epochs;"
    sizes = sorted(used["size"].unique())
    notes.append(" ".join(TESTED_ON[positions] for positions in sorted(used["positions"].unique())))
    notes.append(
        f"Size {', '.join(sizes)}: {num_train} training and {num_test} test experiments;{epochs} seeds {seeds}."
    )
    notes.append("[ ]: 95 % bootstrap interval over clusters of the test split; ±: standard deviation over seeds.")
    if set(sizes) <= PAPER_SIZES:
        notes.append("Bold: the best of ours that sees positions of AB and C alone.")
    else:
        notes.append("The paper's numbers are from more experiments, so nothing is in bold next to them.")
    if "gt_confounders" in used["ablation"].to_numpy():
        notes.append(
            "Where the true confounders are given, they include what positions hide: initial velocity, shape and orientation."
        )
    if table.oracles and used["model"].str.startswith("oracle_").any():
        notes.append(ORACLES_NOTE)
    if names := _unique(used, "derenderer"):
        notes.append(f"Positions estimated by de-renderer {' and '.join(names)} (hash of its checkpoint).")
    if names := _unique(used, "predictor"):
        notes.append(f"Tested from checkpoints (by hash), not trained here: {', '.join(names)}.")
    return " ".join([*notes, table.note]).strip()


def _unique(runs: pd.DataFrame, name: str) -> list[str]:
    return sorted(runs[name].dropna().unique()) if name in runs else []


def _listed(counts: "pd.Series[float]") -> str:
    """Return each number once; they are floats where a failed run has none."""
    return ", ".join(map(str, sorted(counts.astype(int).unique())))


class GainShare(NamedTuple):
    """Share of the possible gain: what AB adds to the best that is possible without it; negative below that.

    Attributes:
        value: 1 for the oracle with AB, 0 for the one without.
        low, high: 95 % interval, paired by experiment.
    """

    value: float
    low: float = np.nan
    high: float = np.nan


UNKNOWN = GainShare(np.nan)


def share_of_gain(ours: Sequence[Scores], without: Sequence[Scores], with_ab: Sequence[Scores]) -> GainShare:
    """Return (oracle without AB - ours) / (oracle without AB - oracle with AB), on the experiments common to all.

    Oracles predict only some experiments of a test split; a model's errors on the others do not count here.

    Args:
        ours: Scores of a method, one per seed; they are averaged.
        without: Scores of the oracle without AB.
        with_ab: Scores of the oracle with AB.

    Returns:
        NaN where the runs were tested on different experiments, or one of the three is missing.
    """
    parts = ours, without, with_ab
    if not all(parts):
        return UNKNOWN
    shared = reduce(np.intersect1d, (scores.experiment for part in parts for scores in part))
    selected = [
        [scores.select(np.intersect1d(scores.experiment, shared, return_indices=True)[1]) for scores in part]
        for part in parts
    ]
    if not len(shared) or not have_same_experiments([scores for part in selected for scores in part]):
        return UNKNOWN
    mse, mse_without, mse_with = (average(part).mse for part in selected)
    gain, possible = mse_without - mse, mse_without - mse_with
    return GainShare(gain.sum() / possible.sum(), *interval(Ratio(gain, possible), selected[0][0].cluster))


CELL_COLUMNS = ("row", "column", "metric", "ours", "sd", "low", "high", "seeds", "failed", "paper")


@dataclass(frozen=True)
class FilledTable:
    """A paper table with our numbers.

    Attributes:
        table: The paper's.
        values: One line per cell, in the table's own unit: row, column, ours, sd over seeds, low and high of the 95 %
            interval, seeds, failed, paper, best, share of the possible gain and its interval (share_low, share_high).
        caption: What the cells are, and which runs they show.
        controls: The table's controls with our numbers; None where it has none.
        left_out: A sentence on runs of smaller sizes, which fill no cell; "" where there are none.
    """

    table: PaperTable
    values: pd.DataFrame
    caption: str
    controls: "FilledTable | None" = None
    left_out: str = ""

    @property
    def has_runs(self) -> bool:
        """Whether any of its cells was run here, successfully or not."""
        return bool(self.values[["seeds", "failed"]].to_numpy().any())

    def lines(self, *, whole: bool) -> pd.DataFrame:
        """Return the lines of `values`; unless `whole`, only those of cells that were run."""
        return self.values if whole else self.values[self.values[["seeds", "failed"]].any(axis=1)]

    def shares(self) -> pd.DataFrame:
        """Return the lines of `values` of all methods except the oracles; none where no share is known."""
        oracles = self.table.oracles
        lines = self.values[~(self.values["row"].isin(oracles) | self.values["column"].isin(oracles))]
        return lines if lines["share"].notna().any() else lines.iloc[:0]


def fill(
    table: PaperTable,
    runs: pd.DataFrame,
    scores: Mapping[Path, Scores] | None = None,
    participants: pd.DataFrame | None = None,
) -> FilledTable:
    """Fill a table with means over seeds and their uncertainty.

    Args:
        table: The paper's.
        runs: See `read_runs`.
        scores: Scores of the runs by directory, for intervals of shares; None for shares of means, without intervals.
        participants: Numbers of human participants, see `cophy.report.pipeline.Supplement`; None without any.
    """
    runs, left_out = _of_largest_size(runs, table)
    values, used = [], []
    for row, column, names, paper in table.cells():
        metric, setting = names.pop("metric"), names.pop("participants", None)
        if setting is not None:
            numbers, cell_runs = _participants(participants, names, setting, metric), runs.iloc[:0]
        else:
            numbers, cell_runs = _cell(runs, names, metric, table.scale)
        used.append(cell_runs)
        values.append({"row": row, "column": column, "metric": metric, **numbers, "paper": paper})
    frame = pd.DataFrame(values, columns=CELL_COLUMNS).astype({"paper": float})
    share, low, high = zip(*_shares(table, frame, used, scores), strict=True)
    has_paper_size = set(pd.concat(used).get("size", [])) <= PAPER_SIZES
    frame = frame.assign(best=_best(table, frame) & has_paper_size, share=share, share_low=low, share_high=high)
    controls = None
    if table.controls:
        nothing: list[list[float | None]] = [[None] * len(table.columns) for _ in table.controls]
        controls = fill(replace(table, rows=table.controls, paper=nothing, controls={}), runs)
    return FilledTable(table, frame, _caption(table, pd.concat(used)), controls, left_out)


def _of_largest_size(runs: pd.DataFrame, table: PaperTable) -> tuple[pd.DataFrame, str]:
    """Return the runs of each scenario's largest size, and a sentence on the others, which saw other data."""
    if "num_train" not in runs:  # none has a result
        return runs, ""
    cells = pd.DataFrame([names for _, _, names, _ in table.cells() if "participants" not in names])
    keys = list(PLACE)
    candidates = runs[pd.MultiIndex.from_frame(runs[keys]).isin(pd.MultiIndex.from_frame(cells[keys]))]
    finished = candidates[candidates["error"].isna()].sort_values("num_train")
    largest = finished.groupby("scenario")["size"].last().to_dict()
    is_largest = [largest.get(name, size) == size for name, size in zip(runs["scenario"], runs["size"], strict=True)]
    remaining = runs[np.array(is_largest, dtype=bool)]
    if not (others := sorted(set(candidates["size"]) - set(remaining["size"]))):
        return remaining, ""
    return remaining, f"A table is of one size; runs of another are left out: {', '.join(others)}."


def _cell(runs: pd.DataFrame, names: dict[str, str], metric: str, scale: float) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the numbers of a cell and the runs that they summarise."""
    runs = select(runs, **names)
    failed = int(runs["error"].notna().sum()) if len(runs) else 0
    values = f"metrics.{metric}"
    runs = runs[runs[values].notna()] if values in runs else runs.iloc[:0]
    if runs.empty:
        return {"seeds": 0, "failed": failed}, runs
    runs = comparable_seeds(runs)
    sd = runs[values].std()
    if not (sd > 0 or runs["is_trained"].any()):  # copy baselines have no random seed
        sd = np.nan
    numbers = {"ours": runs[values].mean(), "sd": sd}
    numbers |= {end: runs[f"{end}.{metric}"].mean() for end in ("low", "high")}
    return {name: scale * value for name, value in numbers.items()} | {"seeds": len(runs), "failed": failed}, runs


def _participants(
    participants: pd.DataFrame | None, names: dict[str, str], setting: str, metric: str
) -> dict[str, Any]:
    """Return the numbers of a cell of human participants; one study counts as one seed."""
    if participants is not None:
        lines = select(participants, scenario=names["scenario"], split=names["split"], setting=setting, metric=metric)
        if len(lines):
            line = lines.iloc[0]
            return {name: line[name] for name in ("ours", "sd", "low", "high")} | {"seeds": 1, "failed": 0}
    return {"seeds": 0, "failed": 0}


def _shares(
    table: PaperTable, values: pd.DataFrame, used: list[pd.DataFrame], scores: Mapping[Path, Scores] | None
) -> list[GainShare]:
    """Return the share of each cell: from scores for the MSE, else from means over the same test experiments."""
    if not table.oracles:
        return [UNKNOWN] * len(values)
    method_axis, other_axis = _axes(table)
    cells = list(zip(values[method_axis], values[other_axis], strict=True))
    runs, means = (dict(zip(cells, column, strict=True)) for column in (used, values["ours"]))
    shares = []
    for (label, other), metric in zip(cells, values["metric"], strict=True):
        compared = [(label, other), (table.oracles[0], other), (table.oracles[-1], other)]
        if any(runs[cell].empty for cell in compared):
            shares.append(UNKNOWN)
        elif scores is not None and metric == "mse":
            shares.append(share_of_gain(*([scores[path] for path in runs[cell]["directory"]] for cell in compared)))
        elif pd.concat([runs[cell] for cell in compared])["num_test"].nunique() > 1:
            shares.append(UNKNOWN)
        else:
            mean, mean_without, mean_with = (means[cell] for cell in compared)
            possible = mean_without - mean_with
            shares.append(GainShare((mean_without - mean) / possible if possible else np.nan))
    return shares


def _axes(table: PaperTable) -> tuple[str, str]:
    """Return the axis of the methods, and the other one."""
    return ("row", "column") if table.methods_in == "rows" else ("column", "row")


def _best(table: PaperTable, values: pd.DataFrame) -> "pd.Series[bool]":
    """Return which cells are the best of the methods that compete."""
    if table.methods_in is None:
        return pd.Series(False, index=values.index)
    method_axis, other_axis = _axes(table)
    competitors = [label for label, method in table.methods.items() if method.competes and not method.is_oracle]
    comparable = values["ours"].where(values[method_axis].isin(competitors))
    best = comparable.groupby(values[other_axis]).transform("min" if table.lower_is_better else "max")
    return comparable.eq(best) & comparable.notna()
