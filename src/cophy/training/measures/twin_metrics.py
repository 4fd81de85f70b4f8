"""Does a prediction tell twins apart as the truth does?

Twins share A, C and the do-operation. Only their confounders differ, which AB alone shows. So a model that does not
look at AB predicts the same for both, and what is measured here says what a model made of AB. No oracle is needed.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchmetrics import Metric, MetricCollection

from cophy.training.measures.metrics import ExperimentMean
from cophy.types import Prediction, Targets


class TwinDifference(NamedTuple):
    """Squared differences between twins, summed over coordinates, objects and steps; 0 where the twin is not there.

    Attributes:
        error: `|ΔP - ΔD|²`, where ΔP is the predicted difference and ΔD the true one, m².
        size: `|ΔD|²`, m².
    """

    error: Float[Tensor, "batch"]
    size: Float[Tensor, "batch"]

    @property
    def explained(self) -> Float[Tensor, "batch"]:
        """What counts towards the share explained: Σ explained ÷ Σ size = 1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|²."""
        return self.size - self.error


def twin_of(pair: Int[Tensor, "batch"]) -> Int[Tensor, "batch"]:
    """Index of each experiment's twin, which stands before it or after it; its own index where there is none."""
    own = torch.arange(len(pair), device=pair.device)
    follows = torch.zeros_like(pair, dtype=torch.bool)
    follows[1:] = pair[1:] == pair[:-1]
    precedes = follows.roll(-1)
    return own + precedes.long() - follows.long()


def have_twins(pair: Int[Tensor, "batch"]) -> bool:
    """Whether any experiment's twin is there."""
    return bool((pair[1:] == pair[:-1]).any())


def twin_difference(prediction: Prediction, targets: Targets, dims: int) -> TwinDifference:
    """How far the predicted difference between twins is from the true one.

    Args:
        prediction: What was predicted; twins follow each other.
        targets: The truth.
        dims: Coordinates that count.
    """
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    true, predicted = (
        torch.where(counted, position - position[twin], 0.0)[..., :dims].double()
        for position in (targets.position, prediction.position)
    )
    return TwinDifference(_squared(predicted - true) - _by_chance(prediction, targets, dims), _squared(true))


def right_twin_chosen(prediction: Prediction, targets: Targets, dims: int) -> Float[Tensor, "batch"]:
    """1 where the prediction is nearer to its own D than to the twin's, ½ where it is as near; NaN without a twin.

    Args:
        prediction: What was predicted; twins follow each other.
        targets: The truth.
        dims: Coordinates that count.
    """
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    own, other = (
        _squared(torch.where(counted, prediction.position - true, 0.0)[..., :dims].double())
        for true in (targets.position, targets.position[twin])
    )
    chosen = torch.where(own < other, 1.0, torch.where(own == other, 0.5, 0.0))
    return torch.where(twin == torch.arange(len(twin), device=twin.device), torch.nan, chosen)


class TwinDifferenceExplained(Metric):
    """The share of the twins' difference that predictions explain: 0 for any model without AB, 1 for a perfect one."""

    explained: Tensor
    size: Tensor

    def __init__(self, dims: int) -> None:
        super().__init__()
        self.dims = dims
        for name in ("explained", "size"):
            self.add_state(name, torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, prediction: Prediction, targets: Targets) -> None:
        """Add a batch, in which twins follow each other."""
        difference = twin_difference(prediction, targets, self.dims)
        self.explained += difference.explained.sum()
        self.size += difference.size.sum()

    def compute(self) -> Tensor:
        """1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|² over all batches."""
        return self.explained / self.size


def twin_collection(dims: int, prefix: str) -> MetricCollection:
    """Both measures as torchmetrics accumulate them, over batches in which twins follow each other.

    Args:
        dims: Coordinates that count.
        prefix: Of their names.
    """
    chosen: ExperimentMean[Prediction, Targets] = ExperimentMean(
        lambda prediction, targets: right_twin_chosen(prediction, targets, dims)
    )
    metrics: dict[str, Metric | MetricCollection] = {
        "twin_difference_explained": TwinDifferenceExplained(dims),
        "right_twin_chosen": chosen,
    }
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


def _by_chance(prediction: Prediction, targets: Targets, dims: int) -> Float[Tensor, "batch"]:
    """How much of |ΔP - ΔD|² the draws of two means are expected to add; nothing where both are the mean of the same draws."""
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    if prediction.draw_variance is None:
        return torch.zeros(len(twin), dtype=torch.float64, device=twin.device)
    variance = prediction.draw_variance + prediction.draw_variance[twin]
    added = torch.where(counted, variance, 0.0)[..., :dims].double().sum(dim=(1, 2, 3))
    same = (prediction.position == prediction.position[twin]).flatten(1).all(dim=1)
    return torch.where(same, 0.0, added)


def _squared(difference: Float[Tensor, "batch steps slots dims"]) -> Float[Tensor, "batch"]:
    return difference.square().sum(dim=(1, 2, 3))
