"""The terms of the training loss (paper Sec. 4.2, Training), as means over what is present."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from cophy.types import Prediction, Targets


def masked_mean(values: Float[Tensor, "batch steps slots"], presence: Bool[Tensor, "batch slots"]) -> Float[Tensor, ""]:
    """Return the mean over the present objects of a batch and their steps; absent slots do not count, not even NaN."""
    counted = presence[:, None].expand_as(values)
    return torch.where(counted, values, 0.0).sum() / counted.sum()


def position_loss(prediction: Prediction, targets: Targets) -> Float[Tensor, ""]:
    """L_mse: mean squared error of the positions, over coordinates, present objects and steps."""
    return masked_mean((prediction.position - targets.position).square().mean(dim=-1), targets.presence)


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
