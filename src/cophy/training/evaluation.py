"""A test in numbers: every measure per experiment.

What the two copies, which need no training, score on a test split: every MSE is read beside theirs.
"""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cophy.bootstrap import Ratio, mean
from cophy.errors import CophyError
from cophy.models.baselines import CopyB, CopyC
from cophy.scenario import Scenario
from cophy.training.metrics import (
    pixel_measures,
    position_measures,
    right_twin_chosen,
    stability_measures,
    twin_difference,
)
from cophy.training.predictor import NOT_FINITE, place_missed
from cophy.types import Batch, Prediction, Targets


def mse_of_copies(batch: Batch, scenario: Scenario, missed_position: Float[Tensor, "3"]) -> dict[str, float]:
    """Test MSE, m², of copy C ("D is C") and of copy B ("D is B").

    Args:
        batch: The test split.
        scenario: Says which coordinates count.
        missed_position: Where an object is predicted that the de-renderer missed in C, metres.
    """
    mse = position_measures(scenario.task)["mse"]
    copies = {"copy_c": CopyC(), "copy_b": CopyB()}
    found = {name: place_missed(copy(batch.inputs), batch, missed_position) for name, copy in copies.items()}
    return {name: mean(mse(prediction, batch.targets).double().numpy()) for name, prediction in found.items()}


def evaluate(prediction: Prediction, targets: Targets, scenario: Scenario) -> dict[str, np.ndarray | Ratio]:
    """Judge the predictions of a test split.

    Args:
        prediction: Of all its experiments.
        targets: The truth.
        scenario: Says which coordinates count, and through which camera pixels are measured.

    Returns:
        Name of a measure to its (experiment,) values; NaN where an experiment does not count. The measures of twins are
        there where the data have twins. `pixel_error_by_height` (experiment, height) is there where errors are given by
        height: its mean is that of the heights' means, as in the paper's Table 1.

    Raises:
        CophyError: A prediction is not finite; it must not drop out of a mean.
    """
    for value in (prediction.position, prediction.stable_logit):
        if value is not None and not value[targets.presence[:, None].expand(value.shape[:3])].isfinite().all():
            raise CophyError(f"the model {NOT_FINITE}")
    num_objects = int(targets.presence.sum(dim=1).max())
    measures = position_measures(scenario.task) | pixel_measures(scenario.task, scenario.camera, num_objects)
    if prediction.stable_logit is not None:
        measures |= stability_measures()
    values: dict[str, np.ndarray | Ratio] = {
        name: measure(prediction, targets).double().numpy() for name, measure in measures.items()
    }
    if at_heights := [value for name, value in values.items() if name.startswith("pixel_error_")]:
        values["pixel_error_by_height"] = np.stack(at_heights, axis=1)
    return values | _of_twins(prediction, targets, scenario.task.metric_dims)


def _of_twins(prediction: Prediction, targets: Targets, dims: int) -> dict[str, np.ndarray | Ratio]:
    chosen = right_twin_chosen(prediction, targets, dims)
    if chosen.isnan().all():
        return {}
    difference = twin_difference(prediction, targets, dims)
    explained = Ratio(difference.explained.numpy(), difference.size.numpy())
    return {"twin_difference_explained": explained, "right_twin_chosen": chosen.double().numpy()}
