"""Batches of tensors that data, models and losses exchange.

Axes: batch; time (frames at 5 Hz, T of them); steps (frames 1 … T-1, those of D); slots (K colours, see
`Scenario.colors`). Metres, seconds; z up. An empty slot is zero in every tensor and False in every mask.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

# Features per object of `Inputs.confounders`: everything that positions do not show and that AB and CD share. These are the
# confounders of the paper, the initial velocity (A and C do not show it), whether the object is a cylinder, and the
# direction of a cylinder's axis or of a block's side (images show both, positions do not).
CONFOUNDERS = (
    *("mass", "friction", "restitution", "gravity_x", "gravity_y"),
    *("velocity_x", "velocity_y", "velocity_z"),
    *("cylinder", "axis_x", "axis_y", "axis_z"),
)

NUM_WITHOUT_POSE = CONFOUNDERS.index("cylinder")  # the features before this one are those that images do not show

# indices of the x and y components of the vectors among them
HORIZONTAL = [[CONFOUNDERS.index(f"{vector}_{axis}") for axis in "xy"] for vector in ("gravity", "velocity", "axis")]

# Features per object of `Inputs.object_type` (one-hot)
OBJECT_TYPES = ("box", "sphere", "cylinder")

# Features per object of `Inputs.pose`, equal for orientations that look equal. A block that stands on its base with
# yaw ψ has cos 4ψ, sin 4ψ. A cylinder whose axis, a line without a sign, has the direction ψ and the height z (1: upright)
# has, with r² = 1 - z², r² cos 2ψ, r² sin 2ψ, r z cos ψ, r z sin ψ, z². All other features are 0; a sphere has only zeros.
POSE = ("block_cos_4", "block_sin_4", "axis_cos_2", "axis_sin_2", "axis_cos_1", "axis_sin_1", "axis_upright")

# n -> the indices of cos nψ and sin nψ among them
POSE_ANGLES = {
    n: [POSE.index(f"{name}_{part}_{n}") for part in ("cos", "sin")]
    for name, n in (("axis", 1), ("axis", 2), ("block", 4))
}

# Axis of the slots in the fields of `Inputs` and `Prediction`; 1 in all others
SLOT_AXIS = {"observed": 2, "observed_stable": 2, "position": 2, "stable_logit": 2, "draw_variance": 2}


@dataclass
class Inputs:
    """Inputs of a model for a batch of experiments: AB and C, never D.

    Where a run uses a de-renderer (`positions=`), positions and presence are its estimates.

    Attributes:
        observed: Positions in AB, metres.
        observed_presence: Which slots hold an object in AB.
        observed_stable: Whether an object of AB stays below the stable speed from one frame to the next.
        initial: Positions in C, metres.
        presence: Which slots hold an object in C, and so in D.
        confounders: The true confounders (`CONFOUNDERS`), standardised over the training set; None unless the
            configuration of the model asks for them.
        object_type: Type of each object of AB (`OBJECT_TYPES`); None unless the model asks for it.
        pose: Orientation of each object at t = 0 (`POSE`), the same in A and C; None unless the model asks for it.
    """

    observed: Float[Tensor, "batch time slots 3"]
    observed_presence: Bool[Tensor, "batch slots"]
    observed_stable: Bool[Tensor, "batch steps slots"]
    initial: Float[Tensor, "batch slots 3"]
    presence: Bool[Tensor, "batch slots"]
    confounders: Float[Tensor, "batch slots features"] | None = None
    object_type: Float[Tensor, "batch slots 3"] | None = None
    pose: Float[Tensor, "batch slots 7"] | None = None

    def __len__(self) -> int:
        return len(self.initial)

    @property
    def num_steps(self) -> int:
        """T-1, the number of frames of D to predict."""
        return self.observed.shape[1] - 1


def true_confounders(inputs: Inputs, count: int = len(CONFOUNDERS)) -> Float[Tensor, "batch slots {count}"]:
    """Return the first `count` features of the true confounders, for a model that asks for them.

    Raises:
        ValueError: They are not among the inputs.
    """
    if inputs.confounders is None:
        raise ValueError(
            "the true confounders are not among the inputs: a model needs confounders: ground_truth for them"
        )
    return inputs.confounders[..., :count]


@dataclass
class Targets:
    """True outcomes of a batch of experiments, for losses and metrics only.

    Attributes:
        position: Positions in D, frames 1 … T-1, metres.
        stable: Whether an object of CD stays below the stable speed since the previous frame.
        presence: True presence in CD.
        initial: True positions in C, metres.
        observed_presence: True presence in AB.
        confounder_class: Index of the mass, and of the friction, among the values of the scenario's grid.
        pair: Index of the twin pair, shared by both twins; -1 in the test split until predictions are scored. Released
            experiments have no twins.
        cell: Index into `Scenario.cells()`; -1 where it is unknown (released data).
    """

    position: Float[Tensor, "batch steps slots 3"]
    stable: Bool[Tensor, "batch steps slots"]
    presence: Bool[Tensor, "batch slots"]
    initial: Float[Tensor, "batch slots 3"]
    observed_presence: Bool[Tensor, "batch slots"]
    confounder_class: Int[Tensor, "batch slots 2"]
    pair: Int[Tensor, "batch"]
    cell: Int[Tensor, "batch"]

    def __len__(self) -> int:
        return len(self.initial)


@dataclass
class Batch:
    """Inputs and targets of a batch of experiments."""

    inputs: Inputs
    targets: Targets

    def __len__(self) -> int:
        return len(self.inputs)


@dataclass
class Prediction:
    """Prediction of D.

    Attributes:
        position: Positions in frames 1 … T-1, metres; values in empty slots are meaningless.
        stable_logit: Positive where the object is predicted to be stable; a single step if the model predicts stability
            once for the whole sequence. None if the model does not predict stability.
        confounder_estimate: The latent estimate U. None if the model has no estimate.
        draw_variance: For Monte Carlo oracles, the sampling variance of `position`, m²; it is subtracted from squared
            errors.
    """

    position: Float[Tensor, "batch steps slots 3"]
    stable_logit: Float[Tensor, "batch steps_or_one slots"] | None = None
    confounder_estimate: Float[Tensor, "batch slots hidden"] | None = None
    draw_variance: Float[Tensor, "batch steps slots 3"] | None = None

    def __len__(self) -> int:
        return len(self.position)


Tensors = TypeVar("Tensors", Inputs, Targets, Batch, Prediction)


def map_tensors(function: Callable[..., Tensor], *batches: Tensors) -> Tensors:
    """Apply a function to corresponding tensors of several batches of one class.

    Args:
        function: Takes one tensor of each batch and returns a tensor.
        *batches: Dataclasses of tensors, possibly nested; None stays None.
    """

    def apply(*values: Any) -> Any:
        if values[0] is None:
            return None
        return function(*values) if isinstance(values[0], Tensor) else map_tensors(function, *values)

    first = batches[0]
    mapped = {field.name: apply(*(getattr(batch, field.name) for batch in batches)) for field in fields(first)}
    return type(first)(**mapped)


def move_to(batch: Tensors, device: torch.device, dtype: torch.dtype) -> Tensors:
    """Move a batch to a device, and its floating-point tensors to a precision."""
    return map_tensors(lambda tensor: tensor.to(device, dtype if tensor.is_floating_point() else None), batch)


def take(batch: Tensors, index: slice | list[int] | Tensor) -> Tensors:
    """Select experiments of a batch."""
    indices = torch.as_tensor(index) if isinstance(index, list) else index
    return map_tensors(lambda tensor: tensor[indices], batch)
