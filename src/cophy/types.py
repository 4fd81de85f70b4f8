"""What passes between data and models. Axes: B batch, T frames (5 Hz), K colour slots, F features; metres, z up."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor

# Per-object features of `Batch.confounders`: all that positions hide and AB and CD share. Besides the confounders of
# the paper these are the initial velocity (invisible in A and C), and shape and orientation at t = 0 (visible in
# images, but not in positions): whether it is a cylinder, and the direction of a cylinder's axis or a block's side.
CONFOUNDERS = (
    *("mass", "friction", "restitution", "gravity_x", "gravity_y"),
    *("velocity_x", "velocity_y", "velocity_z"),
    *("cylinder", "axis_x", "axis_y", "axis_z"),
)

# indices of the x and y components of its vectors
HORIZONTAL = [[CONFOUNDERS.index(f"{vector}_{axis}") for axis in "xy"] for vector in ("gravity", "velocity", "axis")]


class Batch(NamedTuple):
    """Experiments as models see them. Slots that hold no object are zero, and False in the masks.

    observed: (B, T, K, 3) positions of AB; observed_presence: (B, K) objects in AB.
    initial: (B, K, 3) positions in C; presence: (B, K) objects in CD.
    observed_stable: (B, T-1, K) whether an object of AB stays below the stable speed from the frame before until this one.
    confounders: (B, K, 12) true confounders (see CONFOUNDERS), standardised over the training set; constant ones are zero.
    confounder_class: (B, K, 2) index of the mass, and of the friction, among the values the scenario's grid has.
    target: (B, T-1, K, 3) positions of D, frames 1 ... T-1. It, `target_initial`, `target_presence` and `stable` are the
        truth about D: losses and metrics see them, a model gets NaN and False.
    target_initial: (B, K, 3) true positions in C. target_presence: (B, K) objects truly in CD. `observed`, `initial` and
        their presence are what a de-renderer found, where predictors see its estimates.
    stable: (B, T-1, K) the same as observed_stable for D.
    oracle_position, oracle_stable: (B, T-1, K, 3) and (B, T-1, K), what an oracle says of D; None for all other models.
    """

    observed: Tensor
    observed_presence: Tensor
    observed_stable: Tensor
    initial: Tensor
    presence: Tensor
    confounders: Tensor
    confounder_class: Tensor
    target: Tensor
    target_initial: Tensor
    target_presence: Tensor
    stable: Tensor
    oracle_position: Tensor | None = None
    oracle_stable: Tensor | None = None


class Prediction(NamedTuple):
    """What a model says about D.

    position: (B, T-1, K, 3) metres; values in absent slots mean nothing.
    stable_logit: (B, T-1, K), or (B, 1, K) where it is decided once for the sequence; positive means stable.
    confounder_estimate: (B, K, H), the latent U.
    """

    position: Tensor
    stable_logit: Tensor | None = None
    confounder_estimate: Tensor | None = None


def without_truth(batch: Batch) -> Batch:
    """The batch as a model sees it: of D it knows nothing."""
    return batch._replace(
        target=torch.full_like(batch.target, torch.nan),
        target_initial=torch.full_like(batch.target_initial, torch.nan),
        target_presence=torch.zeros_like(batch.target_presence),
        stable=torch.zeros_like(batch.stable),
    )


TensorTuple = TypeVar("TensorTuple", Batch, Prediction)


def map_fields(function: Callable[..., Tensor], *tuples: TensorTuple) -> TensorTuple:
    """The named tuple whose fields are `function` of the fields of the given ones; None stays None."""
    fields: Any = (None if values[0] is None else function(*values) for values in zip(*tuples, strict=True))
    return type(tuples[0])(*fields)
