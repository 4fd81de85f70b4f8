"""Leave out the slots no experiment of a batch needs: 4 balls fill 4 of 9 slots, and pairs cost the square."""

import torch
from torch import Tensor

from cophy.types import Batch, Prediction


def pack(batch: Batch) -> tuple[Batch, Tensor]:
    """The batch with every experiment's objects moved to the front, and the slot each came from (B, P)."""
    used = batch.observed_presence | batch.presence
    width = int(used.sum(dim=1).max())
    slots = used.float().argsort(dim=1, descending=True, stable=True)[:, :width]
    packed = {name: _gather(getattr(batch, name), slots, dim=axis) for name, axis in _SLOT_AXIS.items()}
    return batch._replace(**packed), slots


def unpack(prediction: Prediction, slots: Tensor, num_slots: int) -> Prediction:
    """The prediction with every object back in its slot; empty slots are zero."""

    def scatter(tensor: Tensor | None, dim: int) -> Tensor | None:
        return None if tensor is None else _scatter(tensor, slots, num_slots, dim=dim)

    return Prediction(
        position=_scatter(prediction.position, slots, num_slots, dim=2),
        stable_logit=scatter(prediction.stable_logit, 2),
        confounder_estimate=scatter(prediction.confounder_estimate, 1),
    )


_SLOT_AXIS = {
    "observed": 2,
    "observed_presence": 1,
    "observed_stable": 2,
    "initial": 1,
    "presence": 1,
    "confounders": 1,
    "confounder_class": 1,
    "target": 2,
    "target_initial": 1,
    "target_presence": 1,
    "stable": 2,
}


def _index(slots: Tensor, like: Tensor, dim: int) -> Tensor:
    """`slots` (B, P) with the axes of `like` around axis `dim`."""
    shape = [1] * like.ndim
    shape[0], shape[dim] = slots.shape
    sizes = list(like.shape)
    sizes[dim] = slots.shape[1]
    return slots.view(shape).expand(sizes)


def _gather(tensor: Tensor, slots: Tensor, *, dim: int) -> Tensor:
    return tensor.gather(dim, _index(slots, tensor, dim))


def _scatter(tensor: Tensor, slots: Tensor, num_slots: int, *, dim: int) -> Tensor:
    shape = list(tensor.shape)
    shape[dim] = num_slots
    empty = torch.zeros(shape, dtype=tensor.dtype, device=tensor.device)
    return empty.scatter(dim, _index(slots, tensor, dim), tensor)
