"""Means of what was measured per experiment, and how sure they are."""

import numpy as np
from scipy.stats import bootstrap

RESAMPLES = 2000
AT_ONCE = 100  # resamples in memory


def mean(values: np.ndarray) -> float:
    """Mean over the experiments that count, those that are not NaN."""
    return float(np.nanmean(values))


def interval(values: np.ndarray, pairs: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean (percentiles; the same at every call). pairs: the twin pair that each value is of.

    Twin pairs are resampled, not values: twins share A, C and the do-operation, and so much of their error.
    """
    counts = ~np.isnan(values)
    _, group = np.unique(pairs[counts], return_inverse=True)
    total, size = np.bincount(group, weights=values[counts]), np.bincount(group)
    if len(size) < 2:
        return mean(values), mean(values)
    result = bootstrap(
        (np.arange(len(size)),),
        lambda rows, axis: total[rows].sum(axis=axis) / size[rows].sum(axis=axis),
        n_resamples=RESAMPLES,
        batch=AT_ONCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
