"""How predictions are judged. Every experiment counts once, whatever its number of objects or its batch."""

from collections.abc import Callable

import torch
from torch import Tensor
from torchmetrics import MeanMetric, MetricCollection

from cophy.types import Batch, Prediction

PerExperiment = Callable[[Prediction, Batch], Tensor]


class ExperimentMean(MeanMetric):
    """Mean over experiments of a value per experiment."""

    def __init__(self, value: PerExperiment) -> None:
        super().__init__()
        self.value_of = value

    def update(self, prediction: Prediction, batch: Batch) -> None:  # type: ignore[override]
        """Add a batch."""
        super().update(self.value_of(prediction, batch))


def mean_squared_error(dims: int) -> PerExperiment:
    """(B,) MSE in m² over the first `dims` coordinates, present objects and steps 1 ... T-1 (paper Tables 2-4)."""

    def value(prediction: Prediction, batch: Batch) -> Tensor:
        error = (prediction.position - batch.target)[..., :dims].square().mean(dim=-1)
        return _over_objects(error.mean(dim=1), batch.presence)

    return value


def final_position_error(dims: int) -> PerExperiment:
    """(B,) Euclidean distance in m between predicted and true position at the last step, mean over objects."""

    def value(prediction: Prediction, batch: Batch) -> Tensor:
        error = (prediction.position - batch.target)[:, -1, :, :dims].norm(dim=-1)
        return _over_objects(error, batch.presence)

    return value


def stability_accuracy(prediction: Prediction, batch: Batch) -> Tensor:
    """(B,) share of objects and steps whose stability is predicted right; one decision for all steps counts at each."""
    assert prediction.stable_logit is not None
    right = (prediction.stable_logit > 0) == batch.stable
    return _over_objects(right.float().mean(dim=1), batch.presence)


def stability_base_rate(prediction: Prediction, batch: Batch) -> Tensor:
    """(B,) share of objects and steps that are stable: the accuracy of always saying so."""
    return _over_objects(batch.stable.float().mean(dim=1), batch.presence)


def position_metrics(dims: int) -> MetricCollection:
    """Metrics of every predictor on a scenario whose MSE counts `dims` coordinates."""
    return _collection({"mse": mean_squared_error(dims), "final_position_error": final_position_error(dims)})


def stability_metrics() -> MetricCollection:
    """Metrics of predictors that say whether objects are stable."""
    return _collection({"stability_accuracy": stability_accuracy, "stability_base_rate": stability_base_rate})


def _collection(values: dict[str, PerExperiment]) -> MetricCollection:
    return MetricCollection({name: ExperimentMean(value) for name, value in values.items()}, compute_groups=False)


def _over_objects(values: Tensor, presence: Tensor) -> Tensor:
    """(B, K) -> (B,) mean over present objects."""
    present = presence.to(values.dtype)
    return torch.where(presence, values, 0.0).sum(dim=1) / present.sum(dim=1)
