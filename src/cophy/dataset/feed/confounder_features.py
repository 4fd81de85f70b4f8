"""The true confounders as numbers per object, for models that are given or taught them."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cophy.dataset.state_features import visible_axis
from cophy.scenario import Shape
from cophy.scenario.confounders import ConfounderGrid
from cophy.types import HORIZONTAL

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
        statistics: Of the training set, see `confounder_statistics`.
    """
    mean, deviation = statistics
    return (features - mean) / deviation * presence[..., None]
