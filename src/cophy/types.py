"""What passes between data, models and losses.

Axes: batch; time (frames at 5 Hz, T of them); steps (frames 1 … T-1, those of D); slots (K colours, see
`Scenario.colors`). Metres, seconds; z up. An empty slot is zero in every tensor and False in every mask.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

# Features per object of `Inputs.confounders`: all that positions hide and that AB and CD share. Beside the confounders
# of the paper these are the initial velocity (A and C do not show it), whether the object is a cylinder, and the
# direction of a cylinder's axis or of a block's side (pictures show both, positions do not).
CONFOUNDERS = (
    *("mass", "friction", "restitution", "gravity_x", "gravity_y"),
    *("velocity_x", "velocity_y", "velocity_z"),
    *("cylinder", "axis_x", "axis_y", "axis_z"),
)

# indices of the x and y components of the vectors among them
HORIZONTAL = [[CONFOUNDERS.index(f"{vector}_{axis}") for axis in "xy"] for vector in ("gravity", "velocity", "axis")]

# Features per object of `Inputs.object_type`: 1 for what it is, else 0
OBJECT_TYPES = ("box", "sphere", "cylinder")

# Features per object of `Inputs.pose`, the same wherever an object looks the same. A block that stands on its base and has
# the yaw ψ: cos 4ψ, sin 4ψ. A cylinder whose axis, a line without a sign, has the direction ψ and the height z (1: upright),
# with r² = 1 - z²: r² cos 2ψ, r² sin 2ψ, r z cos ψ, r z sin ψ, z². All others are 0, and all of a sphere.
POSE = ("block_cos_4", "block_sin_4", "axis_cos_2", "axis_sin_2", "axis_cos_1", "axis_sin_1", "axis_upright")

# n -> the indices of cos nψ and sin nψ among them
POSE_ANGLES = {
    n: [POSE.index(f"{of}_{part}_{n}") for part in ("cos", "sin")] for of, n in (("axis", 1), ("axis", 2), ("block", 4))
}


@dataclass
class Inputs:
    """What a model may see of a batch of experiments: AB and C, never D.

    Where positions are estimated, these are what the de-renderer found.

    Attributes:
        observed: Positions in AB, metres.
        observed_presence: Which slots hold an object in AB.
        observed_stable: Whether an object of AB stays below the stable speed from one frame to the next.
        initial: Positions in C, metres.
        presence: Which slots hold an object in C, and so in D.
        confounders: The true confounders (`CONFOUNDERS`), standardised over the training set; None unless the
            configuration of the model asks for them.
        object_type: What each object of AB is (`OBJECT_TYPES`); likewise None unless asked for.
        pose: How each object is turned at t = 0 (`POSE`), the same in A and C; likewise None unless asked for.
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
        """T-1, the frames of D that are to be predicted."""
        return self.observed.shape[1] - 1


def true_confounders(inputs: Inputs) -> Float[Tensor, "batch slots features"]:
    """The true confounders, for a model whose configuration asks for them.

    Raises:
        ValueError: They are not among the inputs.
    """
    if inputs.confounders is None:
        raise ValueError(
            "the true confounders are not among the inputs: a model needs confounders: ground_truth for them"
        )
    return inputs.confounders


@dataclass
class Targets:
    """The truth, for losses and metrics alone.

    Attributes:
        position: Positions in D, frames 1 … T-1, metres.
        stable: Whether an object of CD stays below the stable speed from the frame before until this one.
        presence: Which slots truly hold an object in CD.
        initial: True positions in C, metres.
        observed_presence: Which slots truly hold an object in AB.
        confounder_class: Index of the mass, and of the friction, among the values of the scenario's grid.
        pair: The twin pair that an experiment is of; twins have the same. Released experiments have one each.
        cell: Index among `Scenario.cells()`; -1 where it is not known (released data).
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
    """Experiments: what models see of them, and the truth about them."""

    inputs: Inputs
    targets: Targets

    def __len__(self) -> int:
        return len(self.inputs)


@dataclass
class Prediction:
    """What a model says about D.

    Attributes:
        position: Positions in frames 1 … T-1, metres; values in empty slots mean nothing.
        stable_logit: Positive where the object is said to be stable; a single step where that is decided once for the
            whole sequence. None if the model does not say.
        confounder_estimate: The latent estimate U. None if the model makes none.
        draw_variance: Where the position is a mean of random draws (oracles), the variance that it owes to them, m².
            Squared errors are without it.
    """

    position: Float[Tensor, "batch steps slots 3"]
    stable_logit: Float[Tensor, "batch steps_or_one slots"] | None = None
    confounder_estimate: Float[Tensor, "batch slots hidden"] | None = None
    draw_variance: Float[Tensor, "batch steps slots 3"] | None = None

    def __len__(self) -> int:
        return len(self.position)


Tensors = TypeVar("Tensors", Inputs, Targets, Batch, Prediction)


def map_tensors(function: Callable[..., Tensor], *batches: Tensors) -> Tensors:
    """Apply a function to the tensors that several batches have under the same name.

    Args:
        function: From one tensor of each batch to a tensor.
        *batches: Dataclasses of tensors, all of one class; None stays None.

    Returns:
        A dataclass of that class.
    """

    def apply(*values: Any) -> Any:
        if values[0] is None:
            return None
        return function(*values) if isinstance(values[0], Tensor) else map_tensors(function, *values)

    first = batches[0]
    mapped = {each.name: apply(*(getattr(batch, each.name) for batch in batches)) for each in fields(first)}
    return type(first)(**mapped)


def moved(batch: Tensors, device: torch.device, dtype: torch.dtype) -> Tensors:
    """A batch on the device, and in the precision, of a network.

    Args:
        batch: Any dataclass of tensors.
        device: Where its tensors go.
        dtype: Of its floating-point numbers; masks and indices keep theirs.
    """
    return map_tensors(lambda tensor: tensor.to(device, dtype if tensor.is_floating_point() else None), batch)


def take(batch: Tensors, index: slice | list[int] | Tensor) -> Tensors:
    """Some experiments of a batch."""
    chosen = torch.as_tensor(index) if isinstance(index, list) else index
    return map_tensors(lambda tensor: tensor[chosen], batch)
