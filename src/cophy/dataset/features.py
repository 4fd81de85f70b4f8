"""Convert stored arrays of experiments to batches of tensors: the inputs of a model, and the targets (`to_batch`).

The first functions compute quantities from stored states, such as stability and whether a tower stands. Optional inputs
(confounders, object types, poses) are filled only if the model declares them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cophy.scenario import Scenario, Shape
from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.physics import x_axis, z_axis
from cophy.types import HORIZONTAL, OBJECT_TYPES, Batch, Inputs, Targets

Arrays = dict[str, np.ndarray]


def visible_axis(quaternion_xyzw: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(experiment, slot, 3) direction of a cylinder's axis (its sign chosen so that x ≥ 0) or of a block's own x axis.

    quaternion_xyzw: (experiment, slot, 4). shape: (experiment, slot), codes of `Shape`. Zero for spheres and empty slots.
    """
    along_x, along_z, kind = x_axis(quaternion_xyzw), z_axis(quaternion_xyzw), shape[..., None]
    unsigned = np.where(along_z[..., :1] < 0, -along_z, along_z)
    return np.where(kind == Shape.CYLINDER, unsigned, np.where(kind == Shape.BOX, along_x, 0.0))


def stable_frames(states: np.ndarray, stride: int, stable_speed: float) -> np.ndarray:
    """Which objects are stable in which frames.

    Args:
        states: (experiment, state, slot, 13) position, quaternion xyzw, linear and angular velocity.
        stride: states per frame.
        stable_speed: an object slower than this is stable, m/s.

    Returns:
        (experiment, frame 1 ... T-1, slot) bool: slow at every state after the frame before, up to and with this frame.
    """
    slow = np.linalg.norm(states[..., 7:10], axis=-1) < stable_speed
    num_frames = slow.shape[1] // stride
    after_first = slow[:, 1 : (num_frames - 1) * stride + 1]
    return np.asarray(after_first.reshape(len(slow), num_frames - 1, stride, -1).all(axis=2))


def in_place(arrays: Arrays, distance_m: float) -> np.ndarray:
    """(experiment, sequence, slot) whether the object was always nearer than this to where it started."""
    return np.asarray(_from_start(arrays).max(axis=2) < distance_m)


def stands(arrays: Arrays, fallen_distance: float) -> np.ndarray:
    """(experiment, sequence) whether no block of a tower left its place by `fallen_distance` metres."""
    return np.asarray(in_place(arrays, fallen_distance).all(axis=2))


def mean_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence, slot) how far the object is from where it started, averaged over time, metres."""
    return np.asarray(_from_start(arrays).mean(axis=2))


def objects_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) mean of `mean_distance` over the objects that are there."""
    present = arrays["presence"]
    return np.asarray((mean_distance(arrays) * present).sum(axis=2) / present.sum(axis=2).clip(min=1))


def further_than_twin(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) whether objects move further, on average, than under the twin's confounders."""
    moved = objects_distance(arrays)
    _, pair = np.unique(arrays["twin"], return_inverse=True)
    of_pair = np.stack([np.bincount(pair, weights=m)[pair] / np.bincount(pair)[pair] for m in moved.T], axis=1)
    return np.asarray(moved > of_pair)


def _from_start(arrays: Arrays) -> np.ndarray:
    position = arrays["states"][..., :3]
    return np.asarray(np.linalg.norm(position - position[:, :, :1], axis=-1))


@dataclass(frozen=True)
class DeclaredInputs:
    """Optional fields of `cophy.types.Inputs`: True for those that a model declares."""

    confounders: bool = False
    object_type: bool = False
    pose: bool = False

    @classmethod
    def of(cls, model: Mapping[str, Any]) -> "DeclaredInputs":
        """Return the inputs that the keys of a model declare (conf/model/, or a checkpoint); by default none."""
        return cls(
            confounders=model.get("confounders") == "ground_truth",
            object_type=model.get("object_type") is True,
            pose=model.get("pose") is True,
        )

    @property
    def not_derendered(self) -> str:
        """The declared keys that no de-renderer estimates, joined by "and"; empty if there are none."""
        keys = {"model.object_type=true": self.object_type, "model.pose=true": self.pose}
        return " and ".join(key for key, declared in keys.items() if declared)


def object_types(arrays: dict[str, np.ndarray]) -> Float[Tensor, "batch slots 3"]:
    """One-hot, in the order of `types.OBJECT_TYPES`; empty slots are zero."""
    codes = [Shape[name.upper()] for name in OBJECT_TYPES]
    return torch.from_numpy((arrays["shape"][..., None] == np.array(codes)).astype(np.float32))


def poses(arrays: dict[str, np.ndarray]) -> Float[Tensor, "batch slots 7"]:
    """Features of A in the order of `types.POSE`; do-operations displace and remove, so C shows the same.

    A quarter turn leaves a block as it looks, and a cylinder has two equal ends: hence powers of the direction.
    """
    shape = arrays["shape"]
    axis = visible_axis(arrays["states"][:, 0, 0, :, 3:7].astype(np.float64), shape)
    direction, height = axis[..., 0] + 1j * axis[..., 1], axis[..., 2]
    block = np.where(shape == Shape.BOX, direction**4, 0)
    across, along = (np.where(shape == Shape.CYLINDER, value, 0) for value in (direction**2, direction * height))
    upright = np.where(shape == Shape.CYLINDER, height**2, 0)
    columns = [*(part for pair in (block, across, along) for part in (pair.real, pair.imag)), upright]
    return torch.from_numpy(np.stack(columns, axis=-1).astype(np.float32))


Statistics = tuple[Tensor, Tensor]  # mean and standard deviation of each feature


def confounder_features(arrays: dict[str, np.ndarray]) -> Float[Tensor, "batch slots features"]:
    """All features in the order of `types.CONFOUNDERS`; NaN where released data do not tell them."""
    per_object = np.stack([arrays[name] for name in ("mass", "friction", "restitution")], axis=-1)
    gravity = np.broadcast_to(arrays["gravity"][:, None, :2], (*per_object.shape[:2], 2))
    initial = arrays["states"][:, 0, 0]
    shape = arrays["shape"][..., None]
    axis = visible_axis(initial[..., 3:7], arrays["shape"])
    features = [per_object, gravity, initial[..., 7:10], shape == Shape.CYLINDER, axis]
    return torch.from_numpy(np.concatenate(features, axis=-1, dtype=np.float32))


def confounder_classes(arrays: dict[str, np.ndarray], grid: ConfounderGrid) -> Int[Tensor, "batch slots 2"]:
    """Index of the mass, and of the friction, among the grid's values: of the nearest one."""
    nearest = [
        np.abs(arrays[name][..., None] - np.array(values)).argmin(axis=-1)
        for name, values in (("mass", grid.mass), ("friction", grid.friction))
    ]
    return torch.from_numpy(np.stack(nearest, axis=-1))


def confounder_statistics(
    features: Float[Tensor, "batch slots features"], presence: Bool[Tensor, "batch slots"]
) -> Statistics:
    """Mean and standard deviation (1 for constants) of each feature over the objects of the training set.

    The horizontal components of a vector share theirs, with mean 0. So a vector that is turned after scaling is the
    same as one that is turned before.
    """
    values = features[presence]
    mean, deviation = values.mean(dim=0), values.std(dim=0)
    for columns in HORIZONTAL:
        mean[columns], deviation[columns] = 0.0, values[:, columns].square().mean().sqrt()
    return mean, torch.where(deviation > 0, deviation, 1.0)


def standardised(
    features: Float[Tensor, "batch slots features"], presence: Bool[Tensor, "batch slots"], statistics: Statistics
) -> Float[Tensor, "batch slots features"]:
    """Centre and scale the features; empty slots are zero.

    Args:
        features: See `confounder_features`.
        presence: Which slots hold an object in AB.
        statistics: Statistics of the training set, see `confounder_statistics`.
    """
    mean, deviation = statistics
    return (features - mean) / deviation * presence[..., None]


def to_batch(
    arrays: Arrays,
    scenario: Scenario,
    declared: DeclaredInputs | None = None,
    *,
    statistics: Statistics | None = None,
    estimated: bool = False,
) -> Batch:
    """Return what a model sees of experiments, and the truth.

    Args:
        arrays: as stored, or reduced by `reduce_to_frames`; with estimates, also the arrays of `estimated_inputs`.
        declared: the optional inputs; none of them by default.
        statistics: of the training set, to standardise confounders; needed where these are declared.
        estimated: whether the model sees the estimates of a de-renderer instead of true positions.
    """
    declared = declared or DeclaredInputs()
    if "stable" not in arrays:
        arrays = reduce_to_frames(arrays, scenario)
    true = _true_inputs(arrays)
    confounders = None
    if declared.confounders:
        assert statistics is not None
        confounders = standardised(confounder_features(arrays), true.observed_presence, statistics)
    inputs = replace(
        estimated_inputs(arrays, scenario) if estimated else true,
        confounders=confounders,
        object_type=object_types(arrays) if declared.object_type and not estimated else None,
        pose=poses(arrays) if declared.pose and not estimated else None,
    )
    targets = Targets(
        position=_positions(arrays, 1)[:, 1:],
        stable=torch.from_numpy(arrays["stable"][:, 1]),
        presence=true.presence,
        initial=true.initial,
        observed_presence=true.observed_presence,
        confounder_class=confounder_classes(arrays, scenario.confounders),
        pair=torch.from_numpy(arrays["twin"].astype(np.int64)),
        cell=torch.from_numpy(arrays.get("cell", np.full(len(true), -1)).astype(np.int64)),
    )
    return Batch(inputs, targets)


def reduce_to_frames(arrays: Arrays, scenario: Scenario) -> Arrays:
    """Return the arrays with one state per frame, so that the other states need no memory.

    Returns:
        The same arrays, but `states` is (experiment, 2, T, slot, 13), and `stable` (experiment, 2, T-1, slot) says whether
        an object is slow in all states from one frame to the next.
    """
    stride, states = scenario.clock.states_per_frame, arrays["states"]
    stable = [stable_frames(states[:, sequence], stride, scenario.task.stable_speed) for sequence in (0, 1)]
    present = arrays["presence"][:, :, None]
    return arrays | {"states": states[:, :, ::stride].copy(), "stable": np.stack(stable, axis=1) & present}


def true_inputs(states: np.ndarray, presence: np.ndarray, scenario: Scenario) -> Inputs:
    """Return the true AB and C; D is not read.

    Args:
        states: (experiment, 2, state, slot, 13) of AB and CD, as stored.
        presence: (experiment, 2, slot), which slots hold an object.
        scenario: defines the frame rate and the speed below which an object is stable.
    """
    return _true_inputs(reduce_to_frames({"states": states, "presence": presence}, scenario))


def _true_inputs(arrays: dict[str, np.ndarray]) -> Inputs:
    observed_presence, counterfactual_presence = torch.from_numpy(arrays["presence"]).unbind(1)
    return Inputs(
        observed=_positions(arrays, 0),
        observed_presence=observed_presence,
        observed_stable=torch.from_numpy(arrays["stable"][:, 0]),
        initial=_positions(arrays, 1)[:, 0],
        presence=counterfactual_presence,
    )


def estimated_inputs(estimates: dict[str, np.ndarray], scenario: Scenario) -> Inputs:
    """Return AB and C as estimated by a de-renderer.

    An object is present in AB if most frames of AB show it, and in CD if C shows it. It is stable where its displacement
    between frames is below that of the scenario's stable speed.

    Args:
        estimates: `position` (experiment, 2, T, slot, 3) in metres, and `presence_logit` (experiment, 2, T, slot).
        scenario: defines the frame rate and the stable speed.
    """
    position, logit = (torch.from_numpy(estimates[name]) for name in ("position", "presence_logit"))
    observed_presence, presence = (logit[:, 0] > 0).float().mean(dim=1) > 0.5, logit[:, 1, 0] > 0
    return Inputs(
        observed=position[:, 0] * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=_seems_stable(position[:, 0], scenario) & observed_presence[:, None],
        initial=position[:, 1, 0] * presence[..., None],
        presence=presence,
    )


def _positions(arrays: dict[str, np.ndarray], sequence: int) -> Tensor:
    return torch.from_numpy(arrays["states"][:, sequence, ..., :3].copy())


def _seems_stable(
    position: Float[Tensor, "batch time slots 3"], scenario: Scenario
) -> Bool[Tensor, "batch steps slots"]:
    speed = (position[:, 1:] - position[:, :-1]).norm(dim=-1) * scenario.clock.frame_rate_hz
    return speed < scenario.task.stable_speed
