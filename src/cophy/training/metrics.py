"""How predictions are judged. Every experiment counts once, whatever its number of objects or its batch."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torchmetrics import MeanMetric, Metric, MetricCollection

from cophy.scenario import Camera, Task
from cophy.types import Batch, Prediction

PerExperiment = Callable[[Any, Any], Tensor]  # what was predicted, and what for -> (B,)
RESOLUTION = 448  # paper Table 1: pixel errors are given at 448 x 448


class ExperimentMean(MeanMetric):
    """Mean over experiments of a value per experiment."""

    def __init__(self, value: PerExperiment) -> None:
        super().__init__()
        self.value_of = value

    def update(self, prediction: Any, batch: Any) -> None:  # type: ignore[override]
        """Add a batch."""
        super().update(self.value_of(prediction, batch))


def mean_squared_error(dims: int) -> PerExperiment:
    """(B,) MSE in m² over the first `dims` coordinates, present objects and steps 1 ... T-1 (paper Tables 2-4)."""

    def value(prediction: Prediction, batch: Batch) -> Tensor:
        error = (prediction.position - batch.target)[..., :dims].square().mean(dim=-1)
        return over_objects(error.mean(dim=1), batch.target_presence)

    return value


def final_position_error(dims: int) -> PerExperiment:
    """(B,) Euclidean distance in m between predicted and true position at the last step, mean over objects."""

    def value(prediction: Prediction, batch: Batch) -> Tensor:
        error = (prediction.position - batch.target)[:, -1, :, :dims].norm(dim=-1)
        return over_objects(error, batch.target_presence)

    return value


def pixel_error(camera: Camera) -> PerExperiment:
    """(B,) distance in pixels between predicted and true final position in the camera's picture, mean over objects."""
    return lambda prediction, batch: over_objects(_pixel_distance(camera, prediction, batch), batch.target_presence)


def pixel_error_at_height(camera: Camera, rank: int) -> PerExperiment:
    """(B,) the same for one object, the `rank`-th from below in C (0 is the lowest); NaN where C has fewer objects."""

    def value(prediction: Prediction, batch: Batch) -> Tensor:
        height = torch.where(batch.target_presence, batch.target_initial[..., 2], torch.inf)
        chosen = height.argsort(dim=1)[:, rank : rank + 1]
        distance = _pixel_distance(camera, prediction, batch).gather(1, chosen).squeeze(1)
        return torch.where(batch.target_presence.sum(dim=1) > rank, distance, torch.nan)

    return value


def stability_accuracy(prediction: Prediction, batch: Batch) -> Tensor:
    """(B,) share of objects and steps whose stability is predicted right; one decision for all steps counts at each."""
    right = (_stable_logit(prediction) > 0) == batch.stable
    return over_objects(right.float().mean(dim=1), batch.target_presence)


def stability_base_rate(prediction: Prediction, batch: Batch) -> Tensor:
    """(B,) share of objects and steps that are stable: the accuracy of always saying so."""
    return over_objects(batch.stable.float().mean(dim=1), batch.target_presence)


def sequence_stability_accuracy(prediction: Prediction, batch: Batch) -> Tensor:
    """(B,) share of objects of which is said rightly whether they stay stable at every step (paper Table 6 right)."""
    right = (_stable_logit(prediction) > 0).all(dim=1) == batch.stable.all(dim=1)
    return over_objects(right.float(), batch.target_presence)


def position_measures(task: Task) -> dict[str, PerExperiment]:
    """What every predictor is judged by while it trains."""
    return {"mse": mean_squared_error(task.metric_dims), "final_position_error": final_position_error(task.metric_dims)}


def stability_measures() -> dict[str, PerExperiment]:
    """The same for predictors that say whether objects are stable."""
    return {
        "stability_accuracy": stability_accuracy,
        "stability_base_rate": stability_base_rate,
        "sequence_stability_accuracy": sequence_stability_accuracy,
    }


def pixel_measures(task: Task, camera: Camera, num_objects: int) -> dict[str, PerExperiment]:
    """What is measured in the camera's picture, on the test split; `pixel_error_1` is of the lowest object."""
    ranks = range(num_objects if task.by_height else 0)
    levels = {f"pixel_error_{rank + 1}": pixel_error_at_height(camera, rank) for rank in ranks}
    return {"pixel_error": pixel_error(camera)} | levels


def collection(measures: dict[str, PerExperiment], prefix: str) -> MetricCollection:
    """Measures as torchmetrics accumulate them."""
    metrics: dict[str, Metric | MetricCollection] = {name: ExperimentMean(value) for name, value in measures.items()}
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


def over_objects(values: Tensor, presence: Tensor) -> Tensor:
    """(B, K) -> (B,) mean over present objects."""
    present = presence.to(values.dtype)
    return torch.where(presence, values, 0.0).sum(dim=1) / present.sum(dim=1)


def _stable_logit(prediction: Prediction) -> Tensor:
    assert prediction.stable_logit is not None
    return prediction.stable_logit


def _pixel_distance(camera: Camera, prediction: Prediction, batch: Batch) -> Tensor:
    """(B, K) distance in pixels at the last step."""
    predicted, true = (
        torch.from_numpy(camera.project(position[:, -1].cpu().numpy(), RESOLUTION))
        for position in (prediction.position, batch.target)
    )
    return (predicted - true).norm(dim=-1)
