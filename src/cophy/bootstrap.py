"""Means over experiments, their bootstrap intervals, and their variance over clusters."""

from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

NUM_RESAMPLES = 2000
MAX_RESAMPLES_AT_ONCE = 100  # in memory
MIN_CLUSTERS = 6  # for intervals from variances: means over fewer are too far from normal


class Ratio(NamedTuple):
    """A metric that is a sum over experiments divided by another sum.

    Attributes:
        numerator: (experiment,) values.
        denominator: (experiment,) values.
    """

    numerator: np.ndarray
    denominator: np.ndarray


def mean(values: np.ndarray | Ratio) -> float:
    """Return the mean over the experiments that count (those that are not NaN), or the ratio of two sums.

    For values of two dimensions (experiment, column), it is the mean of the columns' means: every column has the same
    weight, however many experiments it has, unless it has none.
    """
    if isinstance(values, Ratio):
        return float(values.numerator.sum() / values.denominator.sum())
    columns = values[:, ~np.isnan(values).all(axis=0)] if values.ndim == 2 else values
    return float(np.nanmean(columns, axis=0).mean())


def interval(values: np.ndarray | Ratio, clusters: np.ndarray) -> tuple[float, float]:
    """Return the bootstrap 95 % interval of the mean or ratio, by percentiles; it is the same at every call.

    Clusters are resampled, not experiments: twins share A, C and the do-operation, and the pairs of a cluster were assigned the
    same confounders, so their errors are alike.

    Args:
        values: One per experiment, or one per experiment and column; NaN where it does not count.
        clusters: (experiment,) cluster of each experiment.
    """
    parts = values if isinstance(values, Ratio) else Ratio(np.nan_to_num(values), ~np.isnan(values))
    numerator, denominator = (np.reshape(part, (len(clusters), -1)) for part in parts)
    counts = denominator.any(axis=1) | isinstance(values, Ratio)
    unique, group = np.unique(clusters[counts], return_inverse=True)
    if len(unique) < 2:
        return mean(values), mean(values)
    total, size = (_sums(part[counts], group) for part in (numerator, denominator))

    def statistic(rows: np.ndarray, axis: int) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # a sample may have no experiment of a rare column: the others count
            return np.nanmean(total[rows].sum(axis=axis - 1) / size[rows].sum(axis=axis - 1), axis=-1)

    result = bootstrap(
        (np.arange(len(unique)),),
        statistic,
        n_resamples=NUM_RESAMPLES,
        batch=MAX_RESAMPLES_AT_ONCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def variance_of_mean(values: np.ndarray | Ratio, clusters: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the variance of the mean or ratio (linearised) over the choice of clusters, and its degrees of freedom.

    Args:
        values: One per experiment, or one per experiment and column; NaN where it does not count.
        clusters: (experiment,) cluster of each experiment.

    Returns:
        The variance, or that of each column; NaN for fewer than two clusters.
    """
    parts = values if isinstance(values, Ratio) else Ratio(np.nan_to_num(values), ~np.isnan(values))
    numerator, denominator = (np.reshape(part, (len(clusters), -1)) for part in parts)
    counts = denominator.any(axis=1)
    _, group = np.unique(clusters[counts], return_inverse=True)
    total, size = (_sums(part[counts], group) for part in (numerator, denominator))
    residual = (total - total.sum(axis=0) / size.sum(axis=0) * size) / size.mean(axis=0)
    count = len(residual)
    variance = np.square(residual).sum(axis=0) / (count * (count - 1)) if count > 1 else np.full(total.shape[1], np.nan)
    return np.reshape(variance, parts.numerator.shape[1:]), count - 1


def _sums(columns: np.ndarray, group: np.ndarray) -> np.ndarray:
    return np.stack([np.bincount(group, weights=column) for column in columns.T], axis=1)
