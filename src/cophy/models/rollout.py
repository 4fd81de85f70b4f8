"""Limits of rollouts: of steps, so that positions do not diverge, and of gradients, which contacts amplify at every step."""

import torch
from jaxtyping import Float
from torch import Tensor

from cophy.models.contacts import length

SMALLEST_NORM = 1e-12  # so that a gradient of zero is no division by zero


def share_within(max_step: float, displacement: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch slots 1"]:
    """Return the factor, at most 1, that makes a displacement no longer than `max_step`, metres."""
    return (max_step / length(displacement)).clamp(max=1)


def limit_gradient(tensor: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch slots 3"]:
    """Return the tensor; on the way back, the gradient of each experiment has at most the norm 1/batch.

    That is about the gradient where all later positions are off by a metre, because the loss is a mean over experiments (with
    `position_weight` 1 and no loss scaling). Without the limit, a training of alongside on towers of four diverged after 20
    epochs, with gradients of 10⁹.
    """
    if tensor.requires_grad:
        tensor.register_hook(_limited)  # type: ignore[no-untyped-call]
    return tensor


def _limited(gradient: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch slots 3"]:
    norm = torch.linalg.vector_norm(gradient, dim=(1, 2), keepdim=True)
    return gradient * (1 / len(gradient) / (norm + SMALLEST_NORM)).clamp(max=1)
