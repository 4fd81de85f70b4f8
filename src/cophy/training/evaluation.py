"""A test in numbers: every measure per experiment, its mean, and a bootstrap interval."""

import numpy as np
from scipy.stats import bootstrap

from cophy.scenario import Scenario
from cophy.training.metrics import pixel_measures, position_measures, stability_measures
from cophy.types import Batch, Prediction

RESAMPLES = 2000


def evaluate(prediction: Prediction, batch: Batch, scenario: Scenario) -> dict[str, np.ndarray]:
    """Every measure that applies -> (experiment,) values; NaN where an experiment does not count."""
    num_objects = int(batch.presence.sum(dim=1).max())
    measures = position_measures(scenario.task) | pixel_measures(scenario.task, scenario.camera, num_objects)
    if prediction.stable_logit is not None:
        measures |= stability_measures()
    return {name: measure(prediction, batch).double().numpy() for name, measure in measures.items()}


def mean(values: np.ndarray) -> float:
    """Mean over the experiments that count."""
    return float(np.nanmean(values))


def interval(values: np.ndarray) -> tuple[float, float]:
    """Bootstrap 95 % interval of the mean, by resampling experiments (percentiles; the same at every call)."""
    counting = values[~np.isnan(values)]
    if len(counting) < 2:
        return mean(values), mean(values)
    result = bootstrap((counting,), np.mean, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
