"""Scores of predicted D against the truth. It needs NumPy arrays alone: no model, no torch and no configuration.

Every experiment counts once, whatever its number of objects. Twins share A, C and the do-operation; only their confounders
differ, which AB alone shows. A model that ignores AB predicts the same for both, so the metrics of twins measure what a model
infers from AB, without any oracle.

Axes: n experiments, in any order; T-1 steps (frames 1 … T-1); K slots. Metres. Values in empty slots do not count.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Protocol

import numpy as np

from cophy.bootstrap import Ratio, interval, mean
from cophy.errors import CophyError

PIXEL_ERROR_RESOLUTION = 448  # paper Table 1: pixel errors are given at 448 x 448


class Projection(Protocol):
    """A camera, such as `cophy.scenario.Camera`."""

    def project(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """Project (..., 3) metres to (..., 2) pixels of a square image."""


@dataclass(frozen=True)
class Predictions:
    """Predictions of D.

    Attributes:
        experiment: (n,) ids of the experiments.
        position: (n, T-1, K, 3) positions.
        stable_logit: (n, T-1, K), positive where an object is predicted to be stable; (n, 1, K) for one decision for the whole
            sequence; None if stability is not predicted.
        draw_variance: (n, T-1, K, 3) for Monte Carlo oracles, the sampling variance of `position`, m²; it is subtracted from
            squared errors. None for all others.
        samples: (n, S, T-1, K, 3) several predictions of each experiment, whose mean is `position`; None for one.
    """

    experiment: np.ndarray
    position: np.ndarray
    stable_logit: np.ndarray | None = None
    draw_variance: np.ndarray | None = None
    samples: np.ndarray | None = None

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Predictions":
        """Return the predictions of predictions.npz."""
        optional = (arrays.get(name) for name in ("stable_logit", "draw_variance", "samples"))
        return cls(arrays["experiment"], arrays["position"], *optional)


@dataclass(frozen=True)
class Truth:
    """True outcomes of the experiments of a test split, and what their scenario says about metrics.

    Attributes:
        experiment: (n,) ids of the experiments, integers from 0.
        position: (n, T-1, K, 3) positions in D.
        stable: (n, T-1, K) bool, whether an object stays below the stable speed since the previous frame.
        presence: (n, K) bool, which slots hold an object in C and D.
        initial: (n, K, 3) positions in C.
        pair: (n,) twin pair, equal for both twins; negative without a twin.
        cluster: (n,) cluster, in whole twin pairs: experiments whose errors are alike, as their pairs were assigned the same
            two configurations of confounders. Intervals resample clusters. Negative for an experiment that is a cluster of its own.
        cell: (n,) index of the kind of experiment (`Scenario.cells`), for the scores of each, see `Scores.select`.
        metric_dims: Number of coordinates that count (balls: x and y).
        by_height: Whether pixel errors are also given per object, from the lowest in C up.
        camera: Projects positions; None leaves out pixel errors.
    """

    experiment: np.ndarray
    position: np.ndarray
    stable: np.ndarray
    presence: np.ndarray
    initial: np.ndarray
    pair: np.ndarray
    cluster: np.ndarray
    cell: np.ndarray
    metric_dims: int
    by_height: bool = False
    camera: Projection | None = None

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, np.ndarray],
        *,
        metric_dims: int,
        by_height: bool = False,
        camera: Projection | None = None,
    ) -> "Truth":
        """Return the truth in predictions.npz."""
        names = ("experiment", "stable", "presence", "initial", "pair", "cluster", "cell")
        return cls(
            position=arrays["target"],
            metric_dims=metric_dims,
            by_height=by_height,
            camera=camera,
            **{name: arrays[name] for name in names},
        )


@dataclass(frozen=True)
class Scores:
    """Scores of each experiment.

    Attributes:
        experiment: (n,) ids of the experiments.
        cluster: (n,) cluster; an experiment that is one of its own has a negative number of its own.
        truth: (n,) sum of the true coordinates, m; it tells experiments of different data apart.
        values: (n,) values of each measure, or (n, column); NaN if an experiment does not count.
    """

    experiment: np.ndarray
    cluster: np.ndarray
    truth: np.ndarray
    values: Mapping[str, np.ndarray | Ratio]

    @property
    def mse(self) -> np.ndarray:
        """MSE of each experiment, m²."""
        values = self.values["mse"]
        assert isinstance(values, np.ndarray)
        return values

    def means(self) -> dict[str, float]:
        """Return the mean of each measure."""
        return {name: mean(values) for name, values in self.values.items()}

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return the 95 % bootstrap interval of each mean, over clusters."""
        return {name: interval(values, self.cluster) for name, values in self.values.items()}

    def select(self, rows: np.ndarray) -> "Scores":
        """Return the scores of some experiments, by index or mask, without measures of which none has a value."""
        values = {
            name: Ratio(*(part[rows] for part in value)) if isinstance(value, Ratio) else value[rows]
            for name, value in self.values.items()
        }
        values = {name: value for name, value in values.items() if _has_values(value)}
        return Scores(self.experiment[rows], self.cluster[rows], self.truth[rows], values)


def _has_values(values: np.ndarray | Ratio) -> bool:
    return bool(values.denominator.any() if isinstance(values, Ratio) else not np.isnan(values).all())


def score(predictions: Predictions, truth: Truth) -> Scores:
    """Score predictions, which are matched with the truth by the ids of experiments.

    Returns:
        In the order of the truth:

        - mse: m², over the coordinates that count, objects and steps (paper Tables 2-4).
        - final_position_error: mean over objects of the Euclidean distance at the last step, m.
        - pixel_error, with a camera: mean over objects of the distance in its image at the last step. If errors are given by
          height, pixel_error_1 is that of the lowest object in C, and so on; pixel_error_by_height (n, height) has all of
          them: its mean is the mean of the heights' means, as in the paper's Table 1.
        - stability_accuracy, if stability is predicted: share of objects and steps for which it is right.
          stability_base_rate: that of always predicting stable. sequence_stability_accuracy: share of objects for which
          "stable at every step" is right (paper Table 6 right).
        - twin_difference_explained, if there are twins: 1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|², where ΔP is the predicted difference
          between twins and ΔD the true one. right_twin_chosen: 1 if a prediction is nearer to its own D than to the twin's,
          ½ if equally near.
        - energy_score, if there are samples: mean distance of samples to D minus half the mean distance between two samples,
          m; a distance is the square root of an MSE. best_sample_mse: MSE of the sample nearest to D, m².

    Raises:
        CophyError: Experiments are missing, unknown or there twice; an array has a wrong shape or type; or a number of a
            present object is not finite.
    """
    _check_truth(truth)
    matched = aligned(predictions, truth)
    predicted, logit, samples = matched.position, matched.stable_logit, matched.samples
    variance = np.zeros_like(predicted) if matched.draw_variance is None else matched.draw_variance
    presence, dims = truth.presence, truth.metric_dims
    true = _present(truth.position, presence)
    error = predicted - true
    values: dict[str, np.ndarray | Ratio] = {
        "mse": mean_squared_error(predicted, true, presence, dims, variance),
        "final_position_error": mean_over_objects(np.linalg.norm(error[:, -1, :, :dims], axis=-1), presence),
    }
    if truth.camera is not None:
        values |= _pixel_errors(truth.camera, predicted, true, truth)
    if logit is not None:
        values |= _stability(logit > 0, truth)
    if samples is not None:
        values |= _sample_measures(samples, true, presence, dims)
    twin = twins_of(truth.pair)
    if (twin != np.arange(len(twin))).any():
        values |= _twin_measures(predicted[..., :dims], true[..., :dims], twin, variance[..., :dims])
    cluster = np.where(truth.cluster < 0, -1 - truth.experiment.astype(np.int64), truth.cluster)
    return Scores(truth.experiment, cluster, true.sum(axis=(1, 2, 3)), values)


def average(scores: Sequence[Scores]) -> Scores:
    """Return the mean of several scores of the same experiments, such as those of the seeds of a model."""
    return _weighted_sum(scores, [1 / len(scores)] * len(scores))


def compare(ours: Scores, others: Scores) -> Scores:
    """Return the paired differences ours - others of all measures that both have; their intervals are those of the difference.

    Raises:
        CophyError: The scores are not of the same experiments in the same order.
    """
    return _weighted_sum([ours, others], [1.0, -1.0])


def have_same_experiments(scores: Sequence[Scores]) -> bool:
    """Return whether all scores have the same experiments, from the same data, in the same order."""
    names = ("experiment", "cluster", "truth")
    return all(np.array_equal(getattr(scores[0], name), getattr(each, name)) for each in scores[1:] for name in names)


def mean_squared_error(
    predicted: np.ndarray, true: np.ndarray, presence: np.ndarray, dims: int, variance: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the (n,) MSE in m² over the first `dims` coordinates of (n, T-1, K, 3) positions of present (n, K) objects.

    The sampling variance of the predicted positions is subtracted: an unbiased estimate of the MSE of their exact mean.
    """
    squared = np.square(predicted.astype(np.float64) - true) - variance
    return mean_over_objects(squared[..., :dims].mean(axis=(1, 3)), presence)


def mse_of_copies(positions: Mapping[str, np.ndarray], truth: Truth) -> dict[str, float]:
    """Return the MSE in m² of the positions that each copy baseline predicts, in the order of the truth."""
    return {
        name: float(mean_squared_error(each, truth.position, truth.presence, truth.metric_dims).mean())
        for name, each in positions.items()
    }


def mean_over_objects(values: np.ndarray, presence: np.ndarray) -> np.ndarray:
    """Return the (n,) mean of (n, K) values over the present objects of each experiment."""
    return np.asarray(np.where(presence, values, 0.0).sum(axis=1) / presence.sum(axis=1))


def twins_of(pair: np.ndarray) -> np.ndarray:
    """Return the (n,) index of each experiment's twin; its own index without a twin."""
    order = np.argsort(pair, kind="stable")
    follows = np.flatnonzero((np.diff(pair[order]) == 0) & (pair[order][1:] >= 0))
    twin, first, second = np.arange(len(pair)), order[follows], order[follows + 1]
    twin[first], twin[second] = second, first
    return twin


def _pixel_errors(camera: Projection, predicted: np.ndarray, true: np.ndarray, truth: Truth) -> dict[str, np.ndarray]:
    image, true_image = (camera.project(each[:, -1], PIXEL_ERROR_RESOLUTION) for each in (predicted, true))
    distance = np.linalg.norm(image - true_image, axis=-1)
    values = {"pixel_error": mean_over_objects(distance, truth.presence)}
    if truth.by_height:
        height, count = np.where(truth.presence, truth.initial[..., 2], np.inf), truth.presence.sum(axis=1)
        from_below = np.take_along_axis(distance, height.argsort(axis=1, kind="stable"), axis=1)
        ranks = np.arange(count.max())
        by_height = np.where(ranks < count[:, None], from_below[:, : len(ranks)], np.nan)
        values |= {f"pixel_error_{rank + 1}": by_height[:, rank] for rank in ranks}
        values["pixel_error_by_height"] = by_height
    return values


def _stability(predicted: np.ndarray, truth: Truth) -> dict[str, np.ndarray]:
    right, sequence_right = predicted == truth.stable, predicted.all(axis=1) == truth.stable.all(axis=1)
    shares = {
        "stability_accuracy": right.mean(axis=1),
        "stability_base_rate": truth.stable.mean(axis=1),
        "sequence_stability_accuracy": sequence_right,
    }
    return {name: mean_over_objects(share, truth.presence) for name, share in shares.items()}


def _twin_measures(
    predicted: np.ndarray, true: np.ndarray, twin: np.ndarray, variance: np.ndarray
) -> dict[str, np.ndarray | Ratio]:
    """Return the metrics of twins of (n, T-1, K, dims) positions, which are zero in empty slots."""
    predicted_difference, difference = predicted - predicted[twin], true - true[twin]
    same = ~predicted_difference.any(axis=(1, 2, 3))  # both twins share their samples
    sampling = np.where(same, 0.0, (variance + variance[twin]).sum(axis=(1, 2, 3)))
    size, error = _squared(difference), _squared(predicted_difference - difference) - sampling
    distance, twin_distance = _squared(predicted - true), _squared(predicted - true[twin])
    chosen = np.where(distance == twin_distance, 0.5, distance < twin_distance)
    return {
        "twin_difference_explained": Ratio(size - error, size),
        "right_twin_chosen": np.where(twin == np.arange(len(twin)), np.nan, chosen),
    }


def _sample_measures(samples: np.ndarray, true: np.ndarray, presence: np.ndarray, dims: int) -> dict[str, np.ndarray]:
    """Return the measures of (n, S, T-1, K, 3) samples: each is scored as a prediction of its own, and against the others."""
    drawn = list(samples.swapaxes(0, 1))
    mse = np.stack([mean_squared_error(each, true, presence, dims) for each in drawn])
    pairs = [mean_squared_error(one, other, presence, dims) for one, other in combinations(drawn, 2)]
    spread = np.sqrt(pairs).mean(axis=0) if pairs else 0.0
    return {"energy_score": np.sqrt(mse).mean(axis=0) - spread / 2, "best_sample_mse": mse.min(axis=0)}


def _squared(difference: np.ndarray) -> np.ndarray:
    return np.asarray(np.square(difference).sum(axis=(1, 2, 3)))


def _present(values: np.ndarray, presence: np.ndarray) -> np.ndarray:
    """Return (n, T-1, K, ...) values, or (n, S, T-1, K, 3) samples, in double precision, zero in empty slots."""
    slots = 3 if values.ndim == 5 else 2
    present = np.expand_dims(presence, [axis for axis in range(1, values.ndim) if axis != slots])
    return np.where(present, values.astype(np.float64), 0.0)


def aligned(predictions: Predictions, truth: Truth) -> Predictions:
    """Return predictions in the order of the truth, in double precision, zero in empty slots.

    Raises:
        CophyError: See `score`.
    """
    rows, shape = _rows(predictions.experiment, truth.experiment), truth.position.shape
    arrays = {name: getattr(predictions, name) for name in ("position", "stable_logit", "draw_variance", "samples")}
    shapes: dict[str, list[tuple[int, ...]]] = {name: [shape] for name in arrays}
    shapes["stable_logit"] = [shape[:3], (shape[0], 1, shape[2])]
    if arrays["samples"] is not None and arrays["samples"].ndim == 5 and arrays["samples"].size:
        shapes["samples"] = [(shape[0], arrays["samples"].shape[1], *shape[1:])]
    matched = {}
    for name, array in ((name, array) for name, array in arrays.items() if array is not None):
        if array.shape not in shapes[name] or array.dtype.kind != "f":
            choices = " or ".join(map(str, shapes[name]))
            raise CophyError(f"predictions: {name} is {array.dtype} of shape {array.shape}, not floats of {choices}")
        matched[name] = values = _present(array[rows], truth.presence)
        finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
        if not finite.all():
            raise CophyError(
                f"predictions: {name} of experiment {truth.experiment[finite.argmin()]} has non-finite values; "
                "if a training made them, lower its learning rate or look for a division by zero in its model"
            )
    return Predictions(truth.experiment, **matched)


def _rows(predicted: np.ndarray, tested: np.ndarray) -> np.ndarray:
    """Return the index of each tested experiment among the predicted ones."""
    if predicted.ndim != 1 or predicted.dtype.kind not in "iu":
        raise CophyError(
            f"predictions: experiment is {predicted.dtype} of shape {predicted.shape}, not a list of integers"
        )
    ids, counts = np.unique(predicted, return_counts=True)
    problems = {
        "predicted twice": ids[counts > 1],
        "not among those to be scored": np.setdiff1d(ids, tested),
        "missing": np.setdiff1d(tested, ids),
    }
    for problem, wrong in problems.items():
        if len(wrong):
            raise CophyError(f"predictions: {len(wrong)} experiments are {problem}, the first is {wrong[0]}")
    order = predicted.argsort()
    return np.asarray(order[np.searchsorted(predicted, tested, sorter=order)])


def _check_truth(truth: Truth) -> None:
    """Raise CophyError if the arrays do not fit each other, or are no outcomes of experiments."""
    if truth.position.ndim != 4 or not len(truth.position):
        raise CophyError(f"truth: position has shape {truth.position.shape}, not (experiments, T-1, slots, 3)")
    count, steps, slots, _ = truth.position.shape
    expected = {
        "experiment": ((count,), "iu"),
        "position": ((count, steps, slots, 3), "f"),
        "stable": ((count, steps, slots), "b"),
        "presence": ((count, slots), "b"),
        "initial": ((count, slots, 3), "f"),
        "pair": ((count,), "iu"),
        "cluster": ((count,), "iu"),
        "cell": ((count,), "iu"),
    }
    for name, (shape, kinds) in expected.items():
        array = getattr(truth, name)
        if array.shape != shape or array.dtype.kind not in kinds:
            raise CophyError(f"truth: {name} is {array.dtype} of shape {array.shape}, which does not fit {shape}")
    for name, array in (("position", truth.position), ("initial", truth.initial[:, None])):
        finite = np.isfinite(_present(array, truth.presence)).reshape(count, -1).all(axis=1)
        if not finite.all():
            raise CophyError(f"truth: {name} of experiment {truth.experiment[finite.argmin()]} has non-finite values")
    if truth.experiment.min() < 0 or len(np.unique(truth.experiment)) < count:
        raise CophyError("truth: the ids of experiments have to differ and to be at least 0")
    if np.unique(truth.pair[truth.pair >= 0], return_counts=True)[1].max(initial=0) > 2:
        raise CophyError("truth: a twin pair has more than two experiments")
    if (truth.cluster != truth.cluster[twins_of(truth.pair)]).any():
        raise CophyError("truth: twins are in different clusters")
    if not truth.presence.any(axis=1).all():
        raise CophyError("truth: an experiment has no object")


def _weighted_sum(scores: Sequence[Scores], weights: Sequence[float]) -> Scores:
    """Return weighted sums of the measures that all scores have. Ratios of the same truth have the same denominators."""
    if not have_same_experiments(scores):
        raise CophyError("only scores of the same experiments, in the same order, can be compared")

    def weighted(parts: Sequence[Any]) -> Any:
        if isinstance(parts[0], Ratio):
            return Ratio(weighted([part.numerator for part in parts]), parts[0].denominator)
        return sum(weight * part for weight, part in zip(weights, parts, strict=True))

    shared = [name for name in scores[0].values if all(name in each.values for each in scores)]
    return replace(scores[0], values={name: weighted([each.values[name] for each in scores]) for name in shared})
