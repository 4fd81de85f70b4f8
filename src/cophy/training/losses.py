"""The terms of the training loss (paper Sec. 4.2, Training), as means over what is present."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from cophy.errors import CophyError
from cophy.types import Prediction, Targets

# From predicted and true positions (batch, steps, slots, 3), metres, to values (batch, some steps, slots, 3), or without
# the last axis
PositionLoss = Callable[[Tensor, Tensor], Tensor]
MSE = {"_target_": "cophy.training.losses.squared_error"}  # conf/loss/mse.yaml, and the loss of earlier versions


def masked_mean(values: Float[Tensor, "batch steps slots"], presence: Bool[Tensor, "batch slots"]) -> Float[Tensor, ""]:
    """Return the mean over the present objects of a batch and their steps; absent slots do not count, not even NaN."""
    counted = presence[:, None].expand_as(values)
    return torch.where(counted, values, 0.0).sum() / counted.sum()


def squared_error(
    predicted: Float[Tensor, "batch steps slots 3"], target: Float[Tensor, "batch steps slots 3"]
) -> Float[Tensor, "batch steps slots 3"]:
    """Squared error of each coordinate, m² (conf/loss/mse.yaml)."""
    return (predicted - target).square()


def position_loss(prediction: Prediction, targets: Targets, loss: PositionLoss = squared_error) -> Float[Tensor, ""]:
    """Mean of a loss of positions, over coordinates, present objects and steps; with the squared error it is L_mse.

    In empty slots the loss gets zeros, and what it returns there does not count. It may return fewer steps.

    Raises:
        CophyError: It returns another shape.
    """
    present = targets.presence[:, None, :, None]
    predicted, target = (torch.where(present, each, 0.0) for each in (prediction.position, targets.position))
    values = loss(predicted, target)
    shape = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
    size, slots = targets.presence.shape
    if not isinstance(shape, tuple) or shape not in [(size, *shape[1:2], slots, *last) for last in ((3,), ())]:
        raise CophyError(
            f"training.loss returns {shape}, not values of steps for each coordinate or object, ({size}, S, {slots}, 3) or "
            f"({size}, S, {slots}); a loss of torch needs reduction: none"
        )
    return masked_mean(values.mean(dim=-1) if len(shape) == 4 else values, targets.presence)


def stability_loss(logit: Float[Tensor, "batch steps_or_one slots"], targets: Targets) -> Float[Tensor, ""]:
    """L_ce: binary cross entropy of the stability logits."""
    target = stability_target(logit, targets).to(logit.dtype)
    return masked_mean(binary_cross_entropy_with_logits(logit, target, reduction="none"), targets.presence)


def stability_target(
    logit: Float[Tensor, "batch steps_or_one slots"], targets: Targets
) -> Bool[Tensor, "batch steps_or_one slots"]:
    """Return the true stability per step, or, for one logit per sequence, whether the object is always stable."""
    return targets.stable if logit.shape[1] == targets.stable.shape[1] else targets.stable.all(dim=1, keepdim=True)


def confounder_loss(logits: Sequence[Float[Tensor, "batch slots _"]], targets: Targets) -> Float[Tensor, ""]:
    """Cross entropy of mass and of friction, summed; mean over the objects of AB (paper Table 6 middle).

    Args:
        logits: One tensor for mass and one for friction, with a logit for each value of the grid.
        targets: Hold the true classes.
    """
    classes = targets.confounder_class[targets.observed_presence].unbind(-1)
    terms = [
        cross_entropy(logit[targets.observed_presence], value) for logit, value in zip(logits, classes, strict=True)
    ]
    return sum(terms[1:], terms[0])
