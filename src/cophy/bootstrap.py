"""Means of what was measured per experiment, and how sure they are."""

from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

NUM_RESAMPLES = 2000
MAX_RESAMPLES_AT_ONCE = 100  # in memory


class Ratio(NamedTuple):
    """A measure that is the sum of one value over experiments ÷ the sum of another.

    Attributes:
        numerator: (experiment,) values.
        denominator: (experiment,) values.
    """

    numerator: np.ndarray
    denominator: np.ndarray


def mean(values: np.ndarray | Ratio) -> float:
    """Mean over the experiments that count, those that are not NaN; or the ratio of two sums.

    Values of two dimensions (experiment, column) have the mean of their columns' means: every column weighs the same,
    however many experiments it has.
    """
    if isinstance(values, Ratio):
        return float(values.numerator.sum() / values.denominator.sum())
    return float(np.nanmean(values, axis=0).mean())


def interval(values: np.ndarray | Ratio, pairs: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean, or of the ratio (percentiles; the same at every call).

    Twin pairs are resampled, not values: twins share A, C and the do-operation, and so much of their error.

    Args:
        values: One per experiment, or one per experiment and column; NaN where it does not count.
        pairs: (experiment,) the twin pair that it is of.
    """
    parts = values if isinstance(values, Ratio) else Ratio(np.nan_to_num(values), ~np.isnan(values))
    numerator, denominator = (np.reshape(part, (len(pairs), -1)) for part in parts)
    counts = denominator.any(axis=1) | isinstance(values, Ratio)
    found, group = np.unique(pairs[counts], return_inverse=True)
    if len(found) < 2:
        return mean(values), mean(values)
    total, size = (_sums(part[counts], group) for part in (numerator, denominator))

    def statistic(rows: np.ndarray, axis: int) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # a draw may have no experiment of a rare column: it is of the others
            return np.nanmean(total[rows].sum(axis=axis - 1) / size[rows].sum(axis=axis - 1), axis=-1)

    result = bootstrap(
        (np.arange(len(found)),),
        statistic,
        n_resamples=NUM_RESAMPLES,
        batch=MAX_RESAMPLES_AT_ONCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _sums(columns: np.ndarray, group: np.ndarray) -> np.ndarray:
    return np.stack([np.bincount(group, weights=column) for column in columns.T], axis=1)
