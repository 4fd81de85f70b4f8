"""The terms of the training loss (paper Sec. 4.2, Training), as means over what is present."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from cophy.errors import CophyError
from cophy.types import Prediction, Targets

# From predicted and true positions (batch, steps, slots, 3), metres, to losses of the same shape, or without the last axis
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

    In empty slots the loss gets zeros, and what it returns there does not count.

    Raises:
        CophyError: It returns another shape.
    """
    present = targets.presence[:, None, :, None]
    predicted, target = (torch.where(present, each, 0.0) for each in (prediction.position, targets.position))
    values = loss(predicted, target)
    shapes = (target.shape, target.shape[:-1])
    if not isinstance(values, Tensor) or values.shape not in shapes:
        returned = f"shape {tuple(values.shape)}" if isinstance(values, Tensor) else type(values).__name__
        raise CophyError(
            f"training.loss returns {returned}, not a value for each coordinate or object, {tuple(shapes[0])} or "
            f"{tuple(shapes[1])}; a loss of torch needs reduction: none"
        )
    return masked_mean(values.mean(dim=-1) if values.shape == shapes[0] else values, targets.presence)


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
