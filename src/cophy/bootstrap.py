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
    """Mean over the experiments that count, those that are not NaN; or the ratio of two sums."""
    if isinstance(values, Ratio):
        return float(values.numerator.sum() / values.denominator.sum())
    return float(np.nanmean(values))


def interval(values: np.ndarray | Ratio, pairs: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean, or of the ratio (percentiles; the same at every call).

    Twin pairs are resampled, not values: twins share A, C and the do-operation, and so much of their error.

    Args:
        values: One per experiment; NaN where it does not count.
        pairs: (experiment,) the twin pair that it is of.
    """
    counts = ~np.isnan(values) if isinstance(values, np.ndarray) else np.ones(len(values.numerator), dtype=bool)
    parts = values if isinstance(values, Ratio) else Ratio(values, np.ones(len(values)))
    _, group = np.unique(pairs[counts], return_inverse=True)
    total, size = (np.bincount(group, weights=part[counts]) for part in parts)
    if len(size) < 2:
        return mean(values), mean(values)
    result = bootstrap(
        (np.arange(len(size)),),
        lambda rows, axis: total[rows].sum(axis=axis) / size[rows].sum(axis=axis),
        n_resamples=NUM_RESAMPLES,
        batch=MAX_RESAMPLES_AT_ONCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
