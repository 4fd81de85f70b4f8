"""Convert stored arrays of experiments to batches of tensors: the inputs of a model, and the targets (`to_batch`).

Optional inputs (confounders, object types, poses) are filled only if the model declares them.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cophy.dataset.shards import Arrays
from cophy.dataset.states import CONFOUNDERS_OF_OBJECTS, reduce_to_frames, visible_axis
from cophy.scenario import Scenario, Shape
from cophy.scenario.confounders import ConfounderGrid
from cophy.types import HORIZONTAL, OBJECT_TYPES, Batch, Inputs, Targets

Statistics = tuple[Tensor, Tensor]  # mean and standard deviation of each feature


def declared_inputs(model: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the optional fields of `Inputs` that the keys of a model declare (conf/model/, or a checkpoint)."""
    values = {"confounders": ("ground_truth", "without_pose"), "object_type": (True,), "pose": (True,)}
    return tuple(name for name, choices in values.items() if model.get(name) in choices)


def not_derendered(declared: Collection[str]) -> str:
    """Return the keys of the declared inputs that no de-renderer estimates, joined by "and"; empty if there are none."""
    return " and ".join(f"model.{name}=true" for name in declared if name != "confounders")


def object_types(arrays: Arrays) -> Float[Tensor, "batch slots 3"]:
    """Return one-hot types in the order of `types.OBJECT_TYPES`; empty slots are zero."""
    codes = [Shape[name.upper()] for name in OBJECT_TYPES]
    return torch.from_numpy((arrays["shape"][..., None] == np.array(codes)).astype(np.float32))


def poses(arrays: Arrays) -> Float[Tensor, "batch slots 7"]:
    """Return the features of A in the order of `types.POSE`; do-operations only displace and remove, so C has the same.

    Blocks look the same after a quarter turn, and a cylinder has two equal ends: hence powers of the direction.
    """
    shape = arrays["shape"]
    axis = visible_axis(arrays["states"][:, 0, 0, :, 3:7].astype(np.float64), shape)
    direction, height = axis[..., 0] + 1j * axis[..., 1], axis[..., 2]
    block = np.where(shape == Shape.BOX, direction**4, 0)
    across, along = (np.where(shape == Shape.CYLINDER, value, 0) for value in (direction**2, direction * height))
    upright = np.where(shape == Shape.CYLINDER, height**2, 0)
    columns = [*(part for pair in (block, across, along) for part in (pair.real, pair.imag)), upright]
    return torch.from_numpy(np.stack(columns, axis=-1).astype(np.float32))


def confounder_features(arrays: Arrays) -> Float[Tensor, "batch slots features"]:
    """Return all features in the order of `types.CONFOUNDERS`; NaN where they are unknown (released data)."""
    per_object = np.stack([arrays[name] for name in CONFOUNDERS_OF_OBJECTS], axis=-1)
    gravity = np.broadcast_to(arrays["gravity"][:, None, :2], (*per_object.shape[:2], 2))
    initial = arrays["states"][:, 0, 0]
    shape = arrays["shape"][..., None]
    axis = visible_axis(initial[..., 3:7], arrays["shape"])
    features = [per_object, gravity, initial[..., 7:10], shape == Shape.CYLINDER, axis]
    return torch.from_numpy(np.concatenate(features, axis=-1, dtype=np.float32))


def confounder_classes(arrays: Arrays, grid: ConfounderGrid) -> Int[Tensor, "batch slots 2"]:
    """Return the index of the nearest value of the grid, for the mass and for the friction."""
    nearest = [
        np.abs(arrays[name][..., None] - np.array(values)).argmin(axis=-1)
        for name, values in (("mass", grid.mass), ("friction", grid.friction))
    ]
    return torch.from_numpy(np.stack(nearest, axis=-1))


def confounder_statistics(
    features: Float[Tensor, "batch slots features"], presence: Bool[Tensor, "batch slots"]
) -> Statistics:
    """Return mean and standard deviation (1 for constants) of each feature over the objects of the training set.

    The horizontal components of a vector share one deviation and have mean 0, so that rotations commute with scaling.
    """
    values = features[presence]
    mean, deviation = values.mean(dim=0), values.std(dim=0)
    for columns in HORIZONTAL:
        mean[columns], deviation[columns] = 0.0, values[:, columns].square().mean().sqrt()
    is_constant = values.amin(dim=0) == values.amax(dim=0)  # rounding gives most constants a deviation above 0
    for columns in HORIZONTAL:
        is_constant[columns] = is_constant[columns].all()
    return mean, torch.where(is_constant | (deviation == 0), 1.0, deviation)


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
    declared: Collection[str] = (),
    *,
    statistics: Statistics | None = None,
    estimated: bool = False,
) -> Batch:
    """Return the inputs of a model for these experiments, and the targets.

    Args:
        arrays: As stored, or reduced by `reduce_to_frames`; with estimates, also the arrays of `estimated_inputs`.
        declared: The optional inputs, see `declared_inputs`.
        statistics: Statistics of the training set, to standardise declared confounders.
        estimated: Whether positions are the estimates of a de-renderer; object types and poses are then omitted.
    """
    if "stable" not in arrays:
        arrays = reduce_to_frames(arrays, scenario)
    true = true_inputs(arrays)
    inputs = estimated_inputs(arrays, scenario) if estimated else true
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
    if "confounders" in declared:
        assert statistics is not None
        inputs.confounders = standardised(confounder_features(arrays), targets.observed_presence, statistics)
    return Batch(inputs if estimated else add_appearance(inputs, arrays, declared), targets)


def add_appearance(inputs: Inputs, arrays: Arrays, declared: Collection[str]) -> Inputs:
    """Return the inputs with object types and poses, where they are declared (`declared_inputs`)."""
    computed = {"object_type": object_types, "pose": poses}
    return replace(inputs, **{name: compute(arrays) for name, compute in computed.items() if name in declared})


def true_inputs(arrays: Arrays) -> Inputs:
    """Return the true AB and C, from `states`, `stable` and `presence` of `reduce_to_frames`; D is not read."""
    observed_presence, presence = torch.from_numpy(arrays["presence"]).unbind(1)
    return Inputs(
        observed=_positions(arrays, 0),
        observed_presence=observed_presence,
        observed_stable=torch.from_numpy(arrays["stable"][:, 0]),
        initial=_positions(arrays, 1)[:, 0],
        presence=presence,
    )


def estimated_inputs(estimates: Arrays, scenario: Scenario) -> Inputs:
    """Return AB and C as estimated by a de-renderer.

    An object is present in AB if most frames of AB show it, and in CD if C shows it. It is stable between two
    frames if its mean speed is below the scenario's stable speed.

    Args:
        estimates: `position` (experiment, 2, T, slot, 3) in metres, and `presence_logit` (experiment, 2, T, slot).
        scenario: defines the frame rate and the stable speed.
    """
    position, logit = (torch.from_numpy(estimates[name]) for name in ("position", "presence_logit"))
    speed = (position[:, 0, 1:] - position[:, 0, :-1]).norm(dim=-1) * scenario.clock.frame_rate_hz
    observed_presence, presence = (logit[:, 0] > 0).float().mean(dim=1) > 0.5, logit[:, 1, 0] > 0
    return Inputs(
        observed=position[:, 0] * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=(speed < scenario.task.stable_speed) & observed_presence[:, None],
        initial=position[:, 1, 0] * presence[..., None],
        presence=presence,
    )


def _positions(arrays: Arrays, sequence: int) -> Tensor:
    return torch.from_numpy(arrays["states"][:, sequence, ..., :3].copy())
