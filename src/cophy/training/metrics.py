"""What the devices of a run measured, brought together.

How predictions are judged. Every experiment counts once, whatever its number of objects or its batch.
Does a prediction tell twins apart as the truth does?

Twins share A, C and the do-operation. Only their confounders differ, which AB alone shows. So a model that does not
look at AB predicts the same for both, and what is measured here says what a model made of AB. No oracle is needed.
What validation counts beside its means: the MSE of each cell, and towers that stand or fall.
"""

from collections.abc import Callable, Mapping
from typing import Generic, NamedTuple, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, distributed
from torchmetrics import MeanMetric, Metric, MetricCollection
from torchmetrics.classification import BinaryConfusionMatrix

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


class MeanOfEachCell(Metric):
    """Mean over the experiments of each cell; NaN where there are none. Experiments of unknown cell (-1) do not count."""

    total: Tensor
    count: Tensor

    def __init__(self, num_cells: int) -> None:
        super().__init__()
        for name, dtype in (("total", torch.float64), ("count", torch.int64)):
            self.add_state(name, torch.zeros(num_cells, dtype=dtype), dist_reduce_fx="sum")

    def update(self, values: PerExperiment, cell: Tensor) -> None:
        """Add a batch: a value and the index of a cell per experiment."""
        known = cell >= 0
        self.total.index_add_(0, cell[known], values[known].to(self.total))  # trainer.precision may have changed it
        self.count.index_add_(0, cell[known], torch.ones_like(cell[known]))

    def compute(self) -> Tensor:
        """(num_cells,) over all batches."""
        return self.total / self.count


class StandingConfusion(BinaryConfusionMatrix):
    """(2, 2) experiments: rows whether the tower of CD truly stands, columns whether it is said to.

    It stands if every object is stable at every step.
    """

    def update(self, prediction: Prediction, targets: Targets) -> None:  # type: ignore[override]
        """Add a batch of a model that says whether objects are stable."""
        assert prediction.stable_logit is not None
        empty = ~targets.presence[:, None]
        said, true = (
            (stable | empty).flatten(1).all(dim=1) for stable in (prediction.stable_logit > 0, targets.stable)
        )
        super().update(said.long(), true.long())


Part = TypeVar("Part")


def of_all_devices(own: list[Part]) -> list[Part]:
    """The parts of all devices that share a run, in the order of their ranks; alone, what is given."""
    if not distributed.is_initialized():
        return own
    every: list[list[Part]] = [[]] * distributed.get_world_size()
    distributed.all_gather_object(every, own)
    return [part for of_one in every for part in of_one]
