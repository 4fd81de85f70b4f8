"""The terms of the training loss (paper Sec. 4.2, Training), as means over what is present."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from cophy.types import Batch, Prediction


def masked_mean(values: Tensor, presence: Tensor) -> Tensor:
    """Mean over (B, T, K) of the present objects' values, whatever the others are; presence is (B, K)."""
    counted = presence[:, None].expand_as(values)
    return torch.where(counted, values, 0.0).sum() / counted.sum()


def position_loss(prediction: Prediction, batch: Batch) -> Tensor:
    """Mean squared error of the positions, over coordinates, present objects and steps (L_mse)."""
    return masked_mean((prediction.position - batch.target).square().mean(dim=-1), batch.target_presence)


def stability_loss(logit: Tensor, batch: Batch) -> Tensor:
    """Binary cross entropy of the stability logits (L_ce)."""
    target = stability_target(logit, batch).to(logit.dtype)
    return masked_mean(binary_cross_entropy_with_logits(logit, target, reduction="none"), batch.target_presence)


def stability_target(logit: Tensor, batch: Batch) -> Tensor:
    """True stability per step; where the logit stands for the whole sequence, whether the object is always stable."""
    return batch.stable if logit.shape[1] == batch.stable.shape[1] else batch.stable.all(dim=1, keepdim=True)


def confounder_loss(logits: Sequence[Tensor], batch: Batch) -> Tensor:
    """Cross entropy of mass and of friction, summed, mean over the objects of AB (paper Table 6 middle, supervision).

    logits: for each confounder of `Batch.confounder_class`, (B, K, number of its values).
    """
    classes = batch.confounder_class[batch.observed_presence].unbind(-1)
    terms = [cross_entropy(logit[batch.observed_presence], value) for logit, value in zip(logits, classes, strict=True)]
    return sum(terms[1:], terms[0])
