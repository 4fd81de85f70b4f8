"""A test in numbers: every measure per experiment, its mean, and a bootstrap interval."""

import numpy as np
import torch
from scipy.stats import bootstrap

from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.metrics import pixel_measures, position_measures, stability_measures
from cophy.types import Batch, Prediction

RESAMPLES = 2000


def evaluate(prediction: Prediction, batch: Batch, scenario: Scenario) -> dict[str, np.ndarray]:
    """Every measure that applies -> (experiment,) values; NaN where an experiment does not count.

    A prediction that is not finite is an error: it must not drop out of a mean.
    """
    if not torch.isfinite(
        prediction.position[batch.target_presence[:, None].expand(prediction.position.shape[:3])]
    ).all():
        raise CophyError("the model predicts positions that are not finite: lower training.learning_rate")
    num_objects = int(batch.target_presence.sum(dim=1).max())
    measures = position_measures(scenario.task) | pixel_measures(scenario.task, scenario.camera, num_objects)
    if prediction.stable_logit is not None:
        measures |= stability_measures()
    return {name: measure(prediction, batch).double().numpy() for name, measure in measures.items()}


def mean(values: np.ndarray) -> float:
    """Mean over the experiments that count."""
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
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
