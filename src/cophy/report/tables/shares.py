"""Shares of the possible gain, and how sure they are: their interval over twin pairs."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.bootstrap import Ratio, interval
from cophy.training.runs.results import read_predictions


class Errors(NamedTuple):
    """What a run got wrong.

    Attributes:
        mse: (experiment,) mean squared error, m².
        pair: (experiment,) the twin pair that it is of.
        truth: (experiment,) sum of the true coordinates, metres: other data have others.
    """

    mse: np.ndarray
    pair: np.ndarray
    truth: np.ndarray


ErrorsOf = Callable[[dict[Any, Any]], Errors]  # from a run's line (`read_runs`)


def stored_errors(run: dict[Any, Any]) -> Errors:
    """Those of the predictions that a run left."""
    return _stored_errors(run["directory"], int(run["metric_dims"]))


@lru_cache(maxsize=256)  # an oracle is compared with every run
def _stored_errors(directory: Path, dims: int) -> Errors:
    found = read_predictions(directory)
    error = np.square(found["position"] - found["target"]) - found.get("draw_variance", 0.0)
    squared, present = error[..., :dims].mean(axis=(1, 3), dtype=np.float64), found["presence"]
    truth = found["target"].sum(axis=(1, 2, 3), dtype=np.float64)
    return Errors(np.where(present, squared, 0.0).sum(axis=1) / present.sum(axis=1), found["pair"], truth)


class Share(NamedTuple):
    """Of what AB can add to the best that is possible without it; negative for what is worse than that.

    Attributes:
        value: 1 for the oracle with AB, 0 for that without.
        low: Of its 95 % interval, paired by experiment.
        high: Likewise.
    """

    value: float
    low: float = np.nan
    high: float = np.nan


UNKNOWN = Share(np.nan)


def share_of_gain(ours: pd.DataFrame, without: pd.DataFrame, with_ab: pd.DataFrame, errors_of: ErrorsOf) -> Share:
    """(oracle without AB - ours) / (oracle without AB - oracle with AB), of what all of them were tested on.

    Oracles are asked about the first experiments of a test split. A model's errors on the others do not count here.

    Args:
        ours: Runs of a row, one per seed; their errors are averaged.
        without: Runs of the oracle without AB.
        with_ab: Runs of the oracle with AB.
        errors_of: Gives the errors of a run.

    Returns:
        NaN where the runs were tested on other experiments, or one of the three is missing.
    """
    parts = [[errors_of(run) for run in runs.to_dict("records")] for runs in (ours, without, with_ab)]
    if not all(parts):
        return UNKNOWN
    asked = min(len(each.pair) for part in parts for each in part)
    tested = {(each.pair[:asked].tobytes(), each.truth[:asked].tobytes()) for part in parts for each in part}
    if len(tested) > 1:
        return UNKNOWN
    of_ours, of_without, of_with = (np.mean([each.mse[:asked] for each in part], axis=0) for part in parts)
    gained, possible = of_without - of_ours, of_without - of_with
    return Share(gained.sum() / possible.sum(), *interval(Ratio(gained, possible), parts[0][0].pair[:asked]))
