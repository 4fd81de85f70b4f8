"""How predictions are judged. Every experiment counts once, whatever its number of objects or its batch."""

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torchmetrics import MeanMetric, Metric, MetricCollection

from cophy.scenario import Camera, Task
from cophy.types import Prediction, Targets

PerExperiment = Float[Tensor, "batch"]
Measure = Callable[[Prediction, Targets], PerExperiment]
Said = TypeVar("Said")  # what a model says, `Prediction` or a de-renderer's
Truth = TypeVar("Truth")
PIXEL_ERROR_RESOLUTION = 448  # paper Table 1: pixel errors are given at 448 x 448


class ExperimentMean(MeanMetric, Generic[Said, Truth]):
    """Mean over experiments of a value per experiment."""

    def __init__(self, measure: Callable[[Said, Truth], Tensor]) -> None:
        super().__init__()
        self.measure = measure

    def update(self, prediction: Said, truth: Truth) -> None:  # type: ignore[override]
        """Add a batch."""
        super().update(self.measure(prediction, truth))


def mean_squared_error(dims: int) -> Measure:
    """MSE in m² over the first `dims` coordinates, present objects and steps 1 … T-1 (paper Tables 2-4).

    What a mean of draws owes to chance is not counted: in expectation it is the MSE of the exact mean.
    """

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        error = (prediction.position - targets.position).square()
        if prediction.draw_variance is not None:
            error = error - prediction.draw_variance
        return over_objects(error[..., :dims].mean(dim=-1).mean(dim=1), targets.presence)

    return measure


def final_position_error(dims: int) -> Measure:
    """Euclidean distance in m between predicted and true position at the last step, mean over objects."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        error = (prediction.position - targets.position)[:, -1, :, :dims].norm(dim=-1)
        return over_objects(error, targets.presence)

    return measure


def pixel_error(camera: Camera) -> Measure:
    """Distance in pixels between predicted and true final position in the camera's picture, mean over objects."""
    return lambda prediction, targets: over_objects(_pixel_distance(camera, prediction, targets), targets.presence)


def pixel_error_at_height(camera: Camera, rank: int) -> Measure:
    """The same for one object, the `rank`-th from below in C (0 is the lowest); NaN where C has fewer objects."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        height = torch.where(targets.presence, targets.initial[..., 2], torch.inf)
        chosen = height.argsort(dim=1)[:, rank : rank + 1]
        distance = _pixel_distance(camera, prediction, targets).gather(1, chosen).squeeze(1)
        return torch.where(targets.presence.sum(dim=1) > rank, distance, torch.nan)

    return measure


def stability_accuracy(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects and steps whose stability is predicted right; one decision for all steps counts at each."""
    right = (_stable_logit(prediction) > 0) == targets.stable
    return over_objects(right.float().mean(dim=1), targets.presence)


def stability_base_rate(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects and steps that are stable: the accuracy of always saying so."""
    return over_objects(targets.stable.float().mean(dim=1), targets.presence)


def sequence_stability_accuracy(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects of which is said rightly whether they stay stable at every step (paper Table 6 right)."""
    right = (_stable_logit(prediction) > 0).all(dim=1) == targets.stable.all(dim=1)
    return over_objects(right.float(), targets.presence)


def position_measures(task: Task) -> dict[str, Measure]:
    """What every predictor is judged by while it trains."""
    return {"mse": mean_squared_error(task.metric_dims), "final_position_error": final_position_error(task.metric_dims)}


def stability_measures() -> dict[str, Measure]:
    """The same for predictors that say whether objects are stable."""
    return {
        "stability_accuracy": stability_accuracy,
        "stability_base_rate": stability_base_rate,
        "sequence_stability_accuracy": sequence_stability_accuracy,
    }


def pixel_measures(task: Task, camera: Camera, num_objects: int) -> dict[str, Measure]:
    """What is measured in the camera's picture, on the test split; `pixel_error_1` is of the lowest object.

    Args:
        task: Says whether errors are also given by height.
        camera: In whose picture distances are taken.
        num_objects: The most objects that an experiment has in C.
    """
    ranks = range(num_objects if task.by_height else 0)
    levels = {f"pixel_error_{rank + 1}": pixel_error_at_height(camera, rank) for rank in ranks}
    return {"pixel_error": pixel_error(camera)} | levels


def collection(measures: Mapping[str, Callable[[Said, Truth], Tensor]], prefix: str) -> MetricCollection:
    """Measures as torchmetrics accumulate them."""
    metrics: dict[str, Metric | MetricCollection] = {name: ExperimentMean(each) for name, each in measures.items()}
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


def over_objects(values: Float[Tensor, "batch slots"], presence: Bool[Tensor, "batch slots"]) -> PerExperiment:
    """Mean over the present objects of each experiment."""
    present = presence.to(values.dtype)
    return torch.where(presence, values, 0.0).sum(dim=1) / present.sum(dim=1)


def _stable_logit(prediction: Prediction) -> Tensor:
    assert prediction.stable_logit is not None
    return prediction.stable_logit


def _pixel_distance(camera: Camera, prediction: Prediction, targets: Targets) -> Float[Tensor, "batch slots"]:
    """Distance in pixels at the last step."""
    predicted, true = (
        torch.from_numpy(camera.project(position[:, -1].cpu().numpy(), PIXEL_ERROR_RESOLUTION))
        for position in (prediction.position, targets.position)
    )
    return (predicted - true).norm(dim=-1)
