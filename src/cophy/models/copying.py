"""Copying baselines (paper Tables 1-4, 7): nothing to learn, and the first thing to beat."""

import torch
from torch import nn

from cophy.types import Batch, Prediction


class CopyC(nn.Module):
    """D is C: nothing moves, every object is stable."""

    def forward(self, batch: Batch) -> Prediction:
        """Repeat the initial positions for every step."""
        horizon = batch.observed.shape[1] - 1
        position = batch.initial[:, None].repeat(1, horizon, 1, 1)
        return Prediction(position, stable_logit=torch.ones_like(position[..., 0]))


class CopyB(nn.Module):
    """D is B: the do-operation changed nothing."""

    def forward(self, batch: Batch) -> Prediction:
        """Repeat the observed positions and stability, step for step."""
        seen = batch.observed_presence[:, None, :, None]  # what a de-renderer missed in AB stays where it is in C
        position = torch.where(seen, batch.observed[:, 1:], batch.initial[:, None])
        return Prediction(position, stable_logit=2 * batch.observed_stable.to(position.dtype) - 1)
