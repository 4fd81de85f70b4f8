"""Copying baselines (paper Tables 1-4, 7): nothing to learn, and the first thing to beat."""

from torch import nn

from cophy.types import Batch, Prediction


class CopyC(nn.Module):
    """D is C: nothing moves."""

    def forward(self, batch: Batch) -> Prediction:
        """Repeat the initial positions for every step."""
        horizon = batch.observed.shape[1] - 1
        return Prediction(batch.initial[:, None].repeat(1, horizon, 1, 1))


class CopyB(nn.Module):
    """D is B: the do-operation changed nothing."""

    def forward(self, batch: Batch) -> Prediction:
        """Repeat the observed positions, step for step."""
        return Prediction(batch.observed[:, 1:])
