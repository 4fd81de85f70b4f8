"""A test in numbers: every measure per experiment."""

import numpy as np

from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.metrics import pixel_measures, position_measures, stability_measures
from cophy.types import Batch, Prediction

NOT_FINITE = "predicts what is not finite: lower training.learning_rate; or does it read D from the batch, where models find NaN?"


def evaluate(prediction: Prediction, batch: Batch, scenario: Scenario) -> dict[str, np.ndarray]:
    """Every measure that applies -> (experiment,) values; NaN where an experiment does not count.

    A prediction that is not finite is an error: it must not drop out of a mean.
    """
    for value in (prediction.position, prediction.stable_logit):
        if value is not None and not value[batch.target_presence[:, None].expand(value.shape[:3])].isfinite().all():
            raise CophyError(f"the model {NOT_FINITE}")
    num_objects = int(batch.target_presence.sum(dim=1).max())
    measures = position_measures(scenario.task) | pixel_measures(scenario.task, scenario.camera, num_objects)
    if prediction.stable_logit is not None:
        measures |= stability_measures()
    return {name: measure(prediction, batch).double().numpy() for name, measure in measures.items()}
