"""The paper's tables filled with our numbers: one line per cell, in the table's own unit.

Nothing is formatted here; `cophy.report.render` does that, once per medium.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.bootstrap import Ratio, interval
from cophy.report.paper_tables import PaperTable
from cophy.report.runs import comparable_seeds
from cophy.training.run import read_predictions

TESTED_ON = {  # positions= -> sentence of the caption
    "ground_truth": "Tested on true positions.",
    "derendered": "Trained and tested on positions estimated from images.",
    "train_ground_truth_test_derendered": "Tested on positions estimated from images.",
}

ORACLES_NOTE = (
    "Oracles simulate (docs/benchmark/oracles.md). They know what A and C show at t = 0 beyond positions: object type and pose. "
    "A network sees these only with model.object_type=true and model.pose=true. "
    "For Monte Carlo oracles, the sampling variance is subtracted from squared errors."
)


def _caption(table: PaperTable, used: pd.DataFrame) -> str:
    """Return the caption of a table that these runs fill, without its controls."""
    better = "Lower" if table.lower_is_better else "Higher"
    notes = [f"Each cell: ours / the paper's. {better} is better."]
    if used.empty:
        return " ".join([*notes, "Nothing was run yet."])
    num_train, num_test, seeds = (_listed(used[name]) for name in ("num_train", "num_test", "seed"))
    trained = used[
        used["is_trained"].astype(bool)
    ]  # copies and oracles have a number of epochs, too, but are not trained
    epochs = "" if trained.empty else f" {_listed(trained['epochs'])} epochs;"
    size = ", ".join(sorted(used["size"].unique()))
    notes.append(" ".join(TESTED_ON[positions] for positions in sorted(used["positions"].unique())))
    notes.append(f"Size {size}: {num_train} training and {num_test} test experiments;{epochs} seeds {seeds}.")
    notes.append(
        "[ ]: 95 % bootstrap interval over the twin pairs of the test split; ±: standard deviation over seeds."
    )
    if "gt_confounders" in used["ablation"].to_numpy():
        notes.append(
            "Where the true confounders are given, they include what positions hide: initial velocity, shape and orientation."
        )
    if table.oracles and used["model"].str.startswith("oracle_").any():
        notes.append(ORACLES_NOTE)
    if "derenderer" in used and len(names := sorted(used["derenderer"].dropna().unique())):
        notes.append(f"Positions estimated by de-renderer {' and '.join(names)} (hash of its checkpoint).")
    if "predictor" in used and len(tested := used[used["predictor"].notna()]):
        names = sorted({f"{run.model} seed {run.seed} ({run.predictor})" for run in tested.itertuples()})
        notes.append(f"Tested from checkpoints (by hash), not trained here: {', '.join(names)}.")
    return " ".join([*notes, table.note]).strip()


def _listed(counts: "pd.Series[float]") -> str:
    """Return each number once; they are floats where a failed run has none."""
    return ", ".join(map(str, sorted(counts.astype(int).unique())))


class Errors(NamedTuple):
    """Errors of a run.

    Attributes:
        mse: (experiment,) mean squared error, m².
        pair: (experiment,) twin pair of the experiment.
        truth: (experiment,) sum of the true coordinates, m; it tells experiments of different data apart.
    """

    mse: np.ndarray
    pair: np.ndarray
    truth: np.ndarray


ErrorsOf = Callable[[dict[Any, Any]], Errors]  # from a run's line (`read_runs`)


def stored_errors(run: dict[Any, Any]) -> Errors:
    """Return the errors of the predictions that a run stored."""
    return errors_of_predictions(read_predictions(run["directory"]), int(run["metric_dims"]))


def errors_of_predictions(predictions: dict[str, np.ndarray], dims: int) -> Errors:
    """Return the errors of stored predictions (see `read_predictions`) in the first `dims` coordinates."""
    error = np.square(predictions["position"] - predictions["target"]) - predictions.get("draw_variance", 0.0)
    squared, present = error[..., :dims].mean(axis=(1, 3), dtype=np.float64), predictions["presence"]
    truth = predictions["target"].sum(axis=(1, 2, 3), dtype=np.float64)
    return Errors(np.where(present, squared, 0.0).sum(axis=1) / present.sum(axis=1), predictions["pair"], truth)


class Share(NamedTuple):
    """Share of the possible gain: what AB adds to the best that is possible without it; negative below that.

    Attributes:
        value: 1 for the oracle with AB, 0 for the one without.
        low, high: 95 % interval, paired by experiment.
    """

    value: float
    low: float = np.nan
    high: float = np.nan


UNKNOWN = Share(np.nan)


def share_of_gain(ours: pd.DataFrame, without: pd.DataFrame, with_ab: pd.DataFrame, errors_of: ErrorsOf) -> Share:
    """Return (oracle without AB - ours) / (oracle without AB - oracle with AB), on the experiments common to all.

    Oracles predict only the first experiments of a test split; a model's errors on the others do not count here.

    Args:
        ours: Runs of a method, one per seed; their errors are averaged.
        without: Runs of the oracle without AB.
        with_ab: Runs of the oracle with AB.
        errors_of: Returns the errors of a run.

    Returns:
        NaN where the runs were tested on different experiments, or one of the three is missing.
    """
    parts = [[errors_of(run) for run in runs.to_dict("records")] for runs in (ours, without, with_ab)]
    if not all(parts):
        return UNKNOWN
    count = min(len(errors.pair) for part in parts for errors in part)
    if len({(errors.pair[:count].tobytes(), errors.truth[:count].tobytes()) for part in parts for errors in part}) > 1:
        return UNKNOWN
    mse, mse_without, mse_with = (np.mean([errors.mse[:count] for errors in part], axis=0) for part in parts)
    gain, possible = mse_without - mse, mse_without - mse_with
    return Share(gain.sum() / possible.sum(), *interval(Ratio(gain, possible), parts[0][0].pair[:count]))


NUMBERS = ("ours", "sd", "low", "high")


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

    def shares(self) -> pd.DataFrame:
        """Return the lines of `values` of all methods except the oracles; none where no share is known."""
        oracles = self.table.oracles
        lines = self.values[~(self.values["row"].isin(oracles) | self.values["column"].isin(oracles))]
        return lines if lines["share"].notna().any() else lines.iloc[:0]


def fill(
    table: PaperTable,
    runs: pd.DataFrame,
    errors_of: ErrorsOf | None = None,
    participants: pd.DataFrame | None = None,
) -> FilledTable:
    """Fill a table with means over seeds and their uncertainty.

    Args:
        table: The paper's.
        runs: See `read_runs`.
        errors_of: Returns the errors of a run, for intervals of shares; None for shares of means, without intervals.
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
    frame = pd.DataFrame(values).astype({"paper": float})
    share, low, high = zip(*_shares(table, frame, used, errors_of), strict=True)
    frame = frame.assign(best=_best(table, frame), share=share, share_low=low, share_high=high)
    controls = None
    if table.controls:
        nothing: list[list[float | None]] = [[None] * len(table.columns) for _ in table.controls]
        controls = fill(replace(table, rows=table.controls, paper=nothing, controls={}), runs)
    return FilledTable(table, frame, _caption(table, pd.concat(used)), controls, left_out)


def _of_largest_size(runs: pd.DataFrame, table: PaperTable) -> tuple[pd.DataFrame, str]:
    """Return the runs of each scenario's largest size, and a sentence on the others, which saw other data."""
    if "num_train" not in runs:  # none has a result
        return runs, ""
    cells = [{key: value for key, value in names.items() if key != "metric"} for _, _, names, _ in table.cells()]
    candidates = pd.concat([select(runs, **names) for names in cells if "participants" not in names])
    finished = candidates[candidates["error"].isna()].sort_values("num_train")
    largest = finished.groupby("scenario")["size"].last().to_dict()
    is_largest = [largest.get(name, size) == size for name, size in zip(runs["scenario"], runs["size"], strict=True)]
    remaining = runs[is_largest]
    if not (others := sorted(set(candidates["size"]) - set(remaining["size"]))):
        return remaining, ""
    return remaining, f"A table is of one size; runs of another are left out: {', '.join(others)}."


def select(runs: pd.DataFrame, **names: Any) -> pd.DataFrame:
    """Return the runs of these names."""
    if runs.empty:
        return runs
    mask = pd.Series(True, index=runs.index)
    for name, value in names.items():
        mask &= runs[name] == value
    return runs[mask]


def _cell(runs: pd.DataFrame, names: dict[str, str], metric: str, scale: float) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the numbers of a cell and the runs that they summarise."""
    runs = select(runs, **names)
    failed = int(runs["error"].notna().sum()) if len(runs) else 0
    runs = runs[runs[metric].notna()] if metric in runs else runs.iloc[:0]
    if runs.empty:
        return {**dict.fromkeys(NUMBERS, np.nan), "seeds": 0, "failed": failed}, runs
    runs = comparable_seeds(runs)
    low, high = runs[f"{metric}_low"].mean(), runs[f"{metric}_high"].mean()
    numbers = zip(NUMBERS, (runs[metric].mean(), runs[metric].std(), low, high), strict=True)
    return {**{name: scale * value for name, value in numbers}, "seeds": len(runs), "failed": failed}, runs


def _participants(
    participants: pd.DataFrame | None, names: dict[str, str], setting: str, metric: str
) -> dict[str, Any]:
    """Return the numbers of a cell of human participants; one study counts as one seed."""
    wanted = {"scenario": names["scenario"], "split": names["split"], "setting": setting, "metric": metric}
    lines = pd.DataFrame() if participants is None else select(participants, **wanted)
    if lines.empty:
        return {**dict.fromkeys(NUMBERS, np.nan), "seeds": 0, "failed": 0}
    return {**{name: float(lines.iloc[0][name]) for name in NUMBERS}, "seeds": 1, "failed": 0}


def _shares(
    table: PaperTable, values: pd.DataFrame, used: list[pd.DataFrame], errors_of: ErrorsOf | None
) -> list[Share]:
    """Return the share of each cell: from errors for the MSE, else from means over the same test experiments."""
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
        elif errors_of is not None and metric == "mse":
            ours, without, with_ab = (runs[cell] for cell in compared)
            shares.append(share_of_gain(ours, without, with_ab, errors_of))
        elif pd.concat([runs[cell] for cell in compared])["num_test"].nunique() > 1:
            shares.append(UNKNOWN)
        else:
            mean, mean_without, mean_with = (means[cell] for cell in compared)
            possible = mean_without - mean_with
            shares.append(Share((mean_without - mean) / possible if possible else np.nan))
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
