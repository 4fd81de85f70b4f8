"""Metrics that `cophy.scoring` does not define: those of the user, of training, and whether towers stand.

Every experiment counts once, whatever its number of objects.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, distributed

from cophy.errors import CophyError
from cophy.training.instantiation import instantiate_function
from cophy.types import Batch, Prediction, Targets

PerExperiment = Float[Tensor, "batch"]
Measure = Callable[[Prediction, Targets], PerExperiment]
VALIDATED = (  # metrics of validation, beside the MSE of each cell
    *("mse", "final_position_error", "twin_difference_explained", "right_twin_chosen"),
    *("stability_accuracy", "stability_base_rate", "sequence_stability_accuracy"),
)
ONLY_IN_TESTS = ("pixel_error", "probe_")  # the first letters of metrics that validation does not have
NOT_FINITE = "predicts non-finite values: lower training.learning_rate, or look for a division by zero in the model"


def own_measures(metrics: Mapping[str, Any], taken: Collection[str]) -> dict[str, Measure]:
    """Return the metrics of the user by name.

    Args:
        metrics: `_target_` and arguments of each. It is a function of a Prediction and Targets, in which empty slots are zero,
            and returns the (batch,) values of the experiments.
        taken: Names of metrics of this scenario.

    Raises:
        CophyError: A name is taken, or a function cannot be found.
    """
    for name in metrics:
        if name in (*VALIDATED, *taken) or name.endswith("loss") or name.startswith(ONLY_IN_TESTS):
            raise CophyError(f"metrics.{name}: there is a metric or loss of this name; choose another name")
    functions = {name: instantiate_function(f"metrics.{name}", keys) for name, keys in metrics.items()}
    return {name: partial(_checked_values, name, function) for name, function in functions.items()}


def _checked_values(
    name: str, function: Callable[[Prediction, Targets], Any], prediction: Prediction, targets: Targets
) -> PerExperiment:
    position = torch.where(targets.presence[:, None, :, None], prediction.position, 0.0)
    values = function(replace(prediction, position=position), targets)
    if not isinstance(values, Tensor | np.ndarray) or tuple(values.shape) != (len(targets),):
        returned = f"shape {tuple(values.shape)}" if hasattr(values, "shape") else type(values).__name__
        raise CophyError(f"metrics.{name} returns {returned}, not one value for each of {len(targets)} experiments")
    values = torch.as_tensor(values).double()
    if not values.isfinite().all():
        raise CophyError(f"metrics.{name} is not finite in {(~values.isfinite()).sum()} of {len(values)} experiments")
    return values


def mean_squared_error(dims: int) -> Measure:
    """MSE in m² over the first `dims` coordinates, present objects and steps 1 … T-1 (paper Tables 2-4)."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        error = (prediction.position - targets.position).square()
        return over_objects(error[..., :dims].mean(dim=-1).mean(dim=1), targets.presence)

    return measure


def over_objects(values: Float[Tensor, "batch slots"], presence: Bool[Tensor, "batch slots"]) -> PerExperiment:
    """Return the mean over the present objects of each experiment."""
    present = presence.to(values.dtype)
    return torch.where(presence, values, 0.0).sum(dim=1) / present.sum(dim=1)


def standing_confusion(prediction: Prediction, targets: Targets) -> np.ndarray:
    """Return the confusion matrix of towers: rows say whether the tower of CD stands, columns whether it is predicted to.

    A tower stands if every object is stable at every step.
    """
    assert prediction.stable_logit is not None
    empty = ~targets.presence[:, None]
    true, predicted = ((each | empty).flatten(1).all(dim=1) for each in (targets.stable, prediction.stable_logit > 0))
    return (2 * true.long() + predicted).bincount(minlength=4).reshape(2, 2).numpy()


Item = TypeVar("Item")


def gather_devices(items: list[Item]) -> list[Item]:
    """Gather a list from all devices of a run, in the order of their ranks; on one device, return it unchanged."""
    if not distributed.is_initialized():
        return items
    gathered: list[list[Item]] = [[]] * distributed.get_world_size()
    distributed.all_gather_object(gathered, items)
    return [item for device in gathered for item in device]


def place_missed(prediction: Prediction, batch: Batch, position: Float[Tensor, "3"]) -> Prediction:
    """Put objects that the de-renderer missed in C at one position, metres."""
    missed = (batch.targets.presence & ~batch.inputs.presence)[:, None, :, None]
    return replace(prediction, position=torch.where(missed, position, prediction.position))
