"""Scores of predictions as train.py computes them."""

import numpy as np

from cophy.scenario import Scenario
from cophy.scoring import Predictions, Scores, Truth, score
from cophy.training.predictor import prediction_arrays
from cophy.types import Prediction, Targets


def scored(prediction: Prediction, targets: Targets, scenario: Scenario) -> Scores:
    arrays, task = prediction_arrays(prediction, targets, np.arange(len(targets)), targets.pair.numpy()), scenario.task
    truth = Truth.from_arrays(arrays, metric_dims=task.metric_dims, by_height=task.by_height, camera=scenario.camera)
    return score(Predictions.from_arrays(arrays), truth)
