"""Leave out the slots that no experiment of a batch needs: 4 balls fill 4 of 9 slots, and pairs cost the square."""

from dataclasses import fields
from types import NoneType
from typing import Any, get_args

import torch
from jaxtyping import Int
from torch import Tensor

from cophy.types import Inputs, Prediction

MIN_SLOTS = 2  # so that there is always another object, present or not


def pack(inputs: Inputs) -> tuple[Inputs, Int[Tensor, "batch packed"]]:
    """Move the objects of every experiment to the front; also return the slot that each came from."""
    used = inputs.observed_presence | inputs.presence
    width = max(MIN_SLOTS, int(used.sum(dim=1).max()))
    slots = used.float().argsort(dim=1, descending=True, stable=True)[:, :width]
    packed: dict[str, Any] = {}
    for name, axis in _slot_axes(Inputs).items():
        tensor = getattr(inputs, name)
        packed[name] = None if tensor is None else tensor.gather(axis, _index(slots, tensor, axis))
    return Inputs(**packed), slots


def unpack(prediction: Prediction, slots: Int[Tensor, "batch packed"], num_slots: int) -> Prediction:
    """Put every object back into its slot.

    Args:
        prediction: What was predicted from packed inputs.
        slots: The slot that each object came from, see `pack`.
        num_slots: Slots that there are.

    Returns:
        The prediction; empty slots are zero.
    """
    unpacked: dict[str, Any] = {}
    for name, axis in _slot_axes(Prediction).items():
        tensor = getattr(prediction, name)
        unpacked[name] = None if tensor is None else _scatter(tensor, slots, num_slots, axis)
    return Prediction(**unpacked)


def _slot_axes(kind: type[Inputs] | type[Prediction]) -> dict[str, int]:
    """Of every field, the axis that its annotation calls `slots`."""
    axes = {}
    for field in fields(kind):
        (tensor,) = [each for each in get_args(field.type) or (field.type,) if each is not NoneType]
        axes[field.name] = tensor.dim_str.split().index("slots")
    return axes


def _index(slots: Tensor, like: Tensor, axis: int) -> Tensor:
    """`slots` (batch, packed), as wide as `like` along all other axes."""
    shape = [1] * like.ndim
    shape[0], shape[axis] = slots.shape
    sizes = list(like.shape)
    sizes[axis] = slots.shape[1]
    return slots.view(shape).expand(sizes)


def _scatter(tensor: Tensor, slots: Tensor, num_slots: int, axis: int) -> Tensor:
    shape = list(tensor.shape)
    shape[axis] = num_slots
    empty = torch.zeros(shape, dtype=tensor.dtype, device=tensor.device)
    return empty.scatter(axis, _index(slots, tensor, axis), tensor)
