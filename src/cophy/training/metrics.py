"""Metrics in training and validation, on any device and over batches; `cophy.scoring` defines them and scores the test.

Every experiment counts once, whatever its number of objects or its batch.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, distributed
from torchmetrics import MeanMetric, Metric, MetricCollection
from torchmetrics.classification import BinaryConfusionMatrix

from cophy.errors import CophyError
from cophy.scenario import Task
from cophy.training.instantiation import instantiate_function
from cophy.types import Batch, Prediction, Targets

PerExperiment = Float[Tensor, "batch"]
Measure = Callable[[Prediction, Targets], PerExperiment]
PredictionT = TypeVar("PredictionT")  # `Prediction`, or the output of a de-renderer
TargetT = TypeVar("TargetT")
ONLY_IN_TESTS = ("pixel_error", "probe_")  # the first letters of metrics that validation does not have
NOT_FINITE = "predicts non-finite values: lower training.learning_rate, or look for a division by zero in the model"


def own_measures(metrics: Mapping[str, Any], taken: Collection[str]) -> dict[str, Measure]:
    """Return the metrics of the user by name.

    Args:
        metrics: `_target_` and arguments of each. It is a function of a Prediction and Targets, in which empty slots are zero,
            and returns the (batch,) values of the experiments.
        taken: Names of other metrics.

    Raises:
        CophyError: A name is taken, or a function cannot be found.
    """
    for name in metrics:
        if name in taken or name.endswith("loss") or name.startswith(ONLY_IN_TESTS):
            raise CophyError(f"metrics.{name}: there is a metric or loss of this name; choose another name")
    functions = {name: instantiate_function(f"metrics.{name}", keys) for name, keys in metrics.items()}
    return {name: partial(_checked_values, name, function) for name, function in functions.items()}


def _checked_values(
    name: str, function: Callable[[Prediction, Targets], Any], prediction: Prediction, targets: Targets
) -> PerExperiment:
    position = torch.where(targets.presence[:, None, :, None], prediction.position, 0.0)
    values = function(replace(prediction, position=position), targets)
    if not isinstance(values, Tensor | np.ndarray) or tuple(values.shape) != (len(targets),):
        returned = f"shape {tuple(values.shape)}" if hasattr(values, "shape") else type(values).__name__
        raise CophyError(f"metrics.{name} returns {returned}, not one value for each of {len(targets)} experiments")
    values = torch.as_tensor(values).double()
    if not values.isfinite().all():
        raise CophyError(f"metrics.{name} is not finite in {(~values.isfinite()).sum()} of {len(values)} experiments")
    return values


class ExperimentMean(MeanMetric, Generic[PredictionT, TargetT]):
    """Mean over experiments of a value per experiment."""

    def __init__(self, measure: Callable[[PredictionT, TargetT], Tensor], *, skips_nan: bool = False) -> None:
        super().__init__(nan_strategy="ignore" if skips_nan else "warn")
        self.measure = measure

    def update(self, prediction: PredictionT, truth: TargetT) -> None:  # type: ignore[override]
        """Add a batch."""
        super().update(self.measure(prediction, truth))


def mean_squared_error(dims: int) -> Measure:
    """MSE in m² over the first `dims` coordinates, present objects and steps 1 … T-1 (paper Tables 2-4)."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        error = (prediction.position - targets.position).square()
        return over_objects(error[..., :dims].mean(dim=-1).mean(dim=1), targets.presence)

    return measure


def final_position_error(dims: int) -> Measure:
    """Euclidean distance in m between predicted and true position at the last step, mean over objects."""

    def measure(prediction: Prediction, targets: Targets) -> PerExperiment:
        error = (prediction.position - targets.position)[:, -1, :, :dims].norm(dim=-1)
        return over_objects(error, targets.presence)

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

    Twins have to follow each other.
    """
    twin, counted = twin_of(targets.pair), targets.presence[:, None, :, None]
    true, predicted = (
        torch.where(counted, position - position[twin], 0.0)[..., :dims].double()
        for position in (targets.position, prediction.position)
    )
    return TwinDifference(_squared(predicted - true), _squared(true))


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
        lambda prediction, targets: right_twin_chosen(prediction, targets, dims),
        skips_nan=True,  # of experiments without a twin
    )
    metrics: dict[str, Metric | MetricCollection] = {
        "twin_difference_explained": TwinDifferenceExplained(dims),
        "right_twin_chosen": right_twin,
    }
    return MetricCollection(metrics, compute_groups=False, prefix=prefix)


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
