"""How predictions are judged: metrics per experiment, metrics of twins, and the metrics of a whole test split.

Every experiment counts once, whatever its number of objects or its batch. Twins share A, C and the do-operation; only their
confounders differ, which AB alone shows. A model that ignores AB predicts the same for both, so the metrics of twins measure
what a model infers from AB, without any oracle.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, distributed
from torchmetrics import MeanMetric, Metric, MetricCollection
from torchmetrics.classification import BinaryConfusionMatrix

from cophy.bootstrap import Ratio, mean
from cophy.errors import CophyError
from cophy.models.baselines import CopyB, CopyC
from cophy.scenario import Camera, Scenario, Task
from cophy.types import Batch, Prediction, Targets

PerExperiment = Float[Tensor, "batch"]
Measure = Callable[[Prediction, Targets], PerExperiment]
PredictionT = TypeVar("PredictionT")  # `Prediction`, or the output of a de-renderer
TargetT = TypeVar("TargetT")
PIXEL_ERROR_RESOLUTION = 448  # paper Table 1: pixel errors are given at 448 x 448
NOT_FINITE = "predicts non-finite values: lower training.learning_rate, or look for a division by zero in the model"


class ExperimentMean(MeanMetric, Generic[PredictionT, TargetT]):
    """Mean over experiments of a value per experiment."""

    def __init__(self, measure: Callable[[PredictionT, TargetT], Tensor]) -> None:
        super().__init__()
        self.measure = measure

    def update(self, prediction: PredictionT, truth: TargetT) -> None:  # type: ignore[override]
        """Add a batch."""
        super().update(self.measure(prediction, truth))


def mean_squared_error(dims: int) -> Measure:
    """MSE in m² over the first `dims` coordinates, present objects and steps 1 … T-1 (paper Tables 2-4).

    For Monte Carlo oracles, the sampling variance is subtracted: an unbiased estimate of the MSE of the exact mean.
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
    """Distance in pixels between predicted and true final position in the camera's image, mean over objects."""
    return lambda prediction, targets: over_objects(_pixel_distance(camera, prediction, targets), targets.presence)


def pixel_error_at_height(camera: Camera, rank: int) -> Measure:
    """Pixel error of one object, the `rank`-th from below in C (0 is the lowest); NaN if C has fewer objects."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        height = torch.where(targets.presence, targets.initial[..., 2], torch.inf)
        slot = height.argsort(dim=1)[:, rank : rank + 1]
        distance = _pixel_distance(camera, prediction, targets).gather(1, slot).squeeze(1)
        return torch.where(targets.presence.sum(dim=1) > rank, distance, torch.nan)

    return measure


def stability_accuracy(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects and steps whose stability is predicted correctly; one decision for all steps counts at each."""
    right = (_stable_logit(prediction) > 0) == targets.stable
    return over_objects(right.float().mean(dim=1), targets.presence)


def stability_base_rate(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects and steps that are stable: the accuracy of always predicting stable."""
    return over_objects(targets.stable.float().mean(dim=1), targets.presence)


def sequence_stability_accuracy(prediction: Prediction, targets: Targets) -> PerExperiment:
    """Share of objects whose stability at every step is predicted correctly (paper Table 6 right)."""
    right = (_stable_logit(prediction) > 0).all(dim=1) == targets.stable.all(dim=1)
    return over_objects(right.float(), targets.presence)


def position_measures(task: Task) -> dict[str, Measure]:
    """Return the metrics of every predictor in training."""
    return {"mse": mean_squared_error(task.metric_dims), "final_position_error": final_position_error(task.metric_dims)}


def stability_measures() -> dict[str, Measure]:
    """Return the metrics of predictors of stability."""
    return {
        "stability_accuracy": stability_accuracy,
        "stability_base_rate": stability_base_rate,
        "sequence_stability_accuracy": sequence_stability_accuracy,
    }


def pixel_measures(task: Task, camera: Camera, num_objects: int) -> dict[str, Measure]:
    """Return the metrics in the camera's image, for the test split; `pixel_error_1` is that of the lowest object.

    Args:
        task: Says whether errors are also given by height.
        camera: Projects positions.
        num_objects: Largest number of objects in C.
    """
    ranks = range(num_objects if task.by_height else 0)
    levels = {f"pixel_error_{rank + 1}": pixel_error_at_height(camera, rank) for rank in ranks}
    return {"pixel_error": pixel_error(camera)} | levels


def collection(measures: Mapping[str, Callable[[PredictionT, TargetT], Tensor]], prefix: str) -> MetricCollection:
    """Return a torchmetrics collection of means over experiments."""
    metrics: dict[str, Metric | MetricCollection] = {name: ExperimentMean(each) for name, each in measures.items()}
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


def over_objects(values: Float[Tensor, "batch slots"], presence: Bool[Tensor, "batch slots"]) -> PerExperiment:
    """Return the mean over the present objects of each experiment."""
    present = presence.to(values.dtype)
    return torch.where(presence, values, 0.0).sum(dim=1) / present.sum(dim=1)


def _stable_logit(prediction: Prediction) -> Tensor:
    assert prediction.stable_logit is not None
    return prediction.stable_logit


def _pixel_distance(camera: Camera, prediction: Prediction, targets: Targets) -> Float[Tensor, "batch slots"]:
    """Return the distance in pixels at the last step."""
    predicted, true = (
        torch.from_numpy(camera.project(position[:, -1].cpu().numpy(), PIXEL_ERROR_RESOLUTION))
        for position in (prediction.position, targets.position)
    )
    return (predicted - true).norm(dim=-1)


class TwinDifference(NamedTuple):
    """Squared differences between twins, summed over coordinates, objects and steps; 0 without a twin.

    Attributes:
        error: `|ΔP - ΔD|²`, where ΔP is the predicted difference and ΔD the true one, m².
        size: `|ΔD|²`, m².
    """

    error: Float[Tensor, "batch"]
    size: Float[Tensor, "batch"]

    @property
    def explained(self) -> Float[Tensor, "batch"]:
        """Numerator of the share explained: Σ explained ÷ Σ size = 1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|²."""
        return self.size - self.error


def twin_of(pair: Int[Tensor, "batch"]) -> Int[Tensor, "batch"]:
    """Return the index of each experiment's twin, which is next to it; its own index without a twin."""
    index = torch.arange(len(pair), device=pair.device)
    follows = torch.zeros_like(pair, dtype=torch.bool)
    follows[1:] = (pair[1:] == pair[:-1]) & (pair[1:] >= 0)
    precedes = follows.roll(-1)
    return index + precedes.long() - follows.long()


def have_twins(pair: Int[Tensor, "batch"]) -> bool:
    """Return whether any experiment has its twin."""
    return bool(((pair[1:] == pair[:-1]) & (pair[1:] >= 0)).any())


def twin_difference(prediction: Prediction, targets: Targets, dims: int) -> TwinDifference:
    """Compare the predicted difference between twins with the true one, in the first `dims` coordinates.

    Twins have to follow each other. For Monte Carlo oracles, the sampling variance is subtracted.
    """
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    true, predicted = (
        torch.where(counted, position - position[twin], 0.0)[..., :dims].double()
        for position in (targets.position, prediction.position)
    )
    return TwinDifference(_squared(predicted - true) - _sampling_variance(prediction, targets, dims), _squared(true))


def right_twin_chosen(prediction: Prediction, targets: Targets, dims: int) -> Float[Tensor, "batch"]:
    """Return 1 if a prediction is nearer to its own D than to the twin's, ½ if equally near, NaN without a twin."""
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    distance, twin_distance = (
        _squared(torch.where(counted, prediction.position - true, 0.0)[..., :dims].double())
        for true in (targets.position, targets.position[twin])
    )
    score = torch.where(distance < twin_distance, 1.0, torch.where(distance == twin_distance, 0.5, 0.0))
    return torch.where(twin == torch.arange(len(twin), device=twin.device), torch.nan, score)


class TwinDifferenceExplained(Metric):
    """Share of the twins' difference that predictions explain: 0 for any model without AB, 1 for a perfect one."""

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
        """Return 1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|² over all batches."""
        return self.explained / self.size


def twin_collection(dims: int, prefix: str) -> MetricCollection:
    """Return a torchmetrics collection of both metrics of twins, over batches in which twins follow each other."""
    right_twin: ExperimentMean[Prediction, Targets] = ExperimentMean(
        lambda prediction, targets: right_twin_chosen(prediction, targets, dims)
    )
    metrics: dict[str, Metric | MetricCollection] = {
        "twin_difference_explained": TwinDifferenceExplained(dims),
        "right_twin_chosen": right_twin,
    }
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


def _sampling_variance(prediction: Prediction, targets: Targets, dims: int) -> Float[Tensor, "batch"]:
    """Return the expected contribution of sampling noise to |ΔP - ΔD|²; zero if both twins share their samples."""
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
    """Mean over the experiments of each cell; NaN for an empty cell. Experiments of unknown cell (-1) do not count."""

    total: Tensor
    count: Tensor

    def __init__(self, num_cells: int) -> None:
        super().__init__()
        for name, dtype in (("total", torch.float64), ("count", torch.int64)):
            self.add_state(name, torch.zeros(num_cells, dtype=dtype), dist_reduce_fx="sum")

    def update(self, values: PerExperiment, cell: Tensor) -> None:
        """Add a batch of values and indices of cells."""
        known = cell >= 0
        self.total.index_add_(0, cell[known], values[known].to(self.total))  # trainer.precision may have changed it
        self.count.index_add_(0, cell[known], torch.ones_like(cell[known]))

    def compute(self) -> Tensor:
        """Return the (num_cells,) means over all batches."""
        return self.total / self.count


class StandingConfusion(BinaryConfusionMatrix):
    """Confusion matrix of towers: rows say whether the tower of CD stands, columns whether it is predicted to.

    A tower stands if every object is stable at every step.
    """

    def update(self, prediction: Prediction, targets: Targets) -> None:  # type: ignore[override]
        """Add a batch of a model that predicts stability."""
        assert prediction.stable_logit is not None
        empty = ~targets.presence[:, None]
        predicted, true = (
            (stable | empty).flatten(1).all(dim=1) for stable in (prediction.stable_logit > 0, targets.stable)
        )
        super().update(predicted.long(), true.long())


Item = TypeVar("Item")


def gather_devices(items: list[Item]) -> list[Item]:
    """Gather a list from all devices of a run, in the order of their ranks; on one device, return it unchanged."""
    if not distributed.is_initialized():
        return items
    gathered: list[list[Item]] = [[]] * distributed.get_world_size()
    distributed.all_gather_object(gathered, items)
    return [item for device in gathered for item in device]


def place_missed(prediction: Prediction, batch: Batch, position: Float[Tensor, "3"]) -> Prediction:
    """Put objects that the de-renderer missed in C at one position, metres."""
    missed = (batch.targets.presence & ~batch.inputs.presence)[:, None, :, None]
    return replace(prediction, position=torch.where(missed, position, prediction.position))


def mse_of_copies(batch: Batch, scenario: Scenario, missed_position: Float[Tensor, "3"]) -> dict[str, float]:
    """Return the test MSE, m², of copy C ("D is C") and of copy B ("D is B"), the reference values of every MSE.

    Args:
        batch: The test split.
        scenario: Says which coordinates count.
        missed_position: Predicted position of objects that the de-renderer missed in C, metres.
    """
    mse = position_measures(scenario.task)["mse"]
    copies = {"copy_c": CopyC(), "copy_b": CopyB()}
    predictions = {name: place_missed(copy(batch.inputs), batch, missed_position) for name, copy in copies.items()}
    return {name: mean(mse(each, batch.targets).double().numpy()) for name, each in predictions.items()}


def evaluate(prediction: Prediction, targets: Targets, scenario: Scenario) -> dict[str, np.ndarray | Ratio]:
    """Judge the predictions of a test split.

    Args:
        prediction: Predictions for all experiments.
        targets: Targets of the same experiments.
        scenario: Says which coordinates count, and through which camera pixels are measured.

    Returns:
        (experiment,) values of each metric; NaN if an experiment does not count. Metrics of twins are present if the data
        have twins. `pixel_error_by_height` (experiment, height) is present if errors are given by height: its mean is the
        mean of the heights' means, as in the paper's Table 1.

    Raises:
        CophyError: A prediction is not finite; it must not drop out of a mean.
    """
    for value in (prediction.position, prediction.stable_logit):
        if value is not None and not value[targets.presence[:, None].expand(value.shape[:3])].isfinite().all():
            raise CophyError(f"the model {NOT_FINITE}")
    num_objects = int(targets.presence.sum(dim=1).max())
    measures = position_measures(scenario.task) | pixel_measures(scenario.task, scenario.camera, num_objects)
    if prediction.stable_logit is not None:
        measures |= stability_measures()
    values: dict[str, np.ndarray | Ratio] = {
        name: measure(prediction, targets).double().numpy() for name, measure in measures.items()
    }
    if by_height := [value for name, value in values.items() if name.startswith("pixel_error_")]:
        values["pixel_error_by_height"] = np.stack(by_height, axis=1)
    if have_twins(targets.pair):
        dims = scenario.task.metric_dims
        difference = twin_difference(prediction, targets, dims)
        values["twin_difference_explained"] = Ratio(difference.explained.numpy(), difference.size.numpy())
        values["right_twin_chosen"] = right_twin_chosen(prediction, targets, dims).double().numpy()
    return values
