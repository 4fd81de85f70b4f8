"""Object type and pose as numbers per object, for models that declare them."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cophy.dataset.feed.declared_inputs import DeclaredInputs
from cophy.dataset.state_features import visible_axis
from cophy.scenario import Shape
from cophy.types import OBJECT_TYPES, Batch


def with_appearance(batch: Batch, arrays: dict[str, np.ndarray], declared: DeclaredInputs) -> Batch:
    """The batch with what the model declares of object types and poses.

    Args:
        batch: The experiments, with true positions.
        arrays: The same, as they are stored.
        declared: What the model sees of it.
    """
    inputs = replace(
        batch.inputs,
        object_type=object_types(arrays) if declared.object_type else None,
        pose=poses(arrays) if declared.pose else None,
    )
    return replace(batch, inputs=inputs)


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
