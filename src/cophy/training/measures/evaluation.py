"""A test in numbers: every measure per experiment."""

import numpy as np

from cophy.bootstrap import Ratio
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.measures.metrics import pixel_measures, position_measures, stability_measures
from cophy.training.measures.twin_metrics import right_twin_chosen, twin_difference
from cophy.training.model_contract import NOT_FINITE
from cophy.types import Prediction, Targets


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
