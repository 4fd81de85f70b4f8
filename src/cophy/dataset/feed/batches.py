"""Arrays of experiments to tensors: what a model sees of them, and the truth."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cophy.dataset.feed.confounder_features import confounder_classes
from cophy.dataset.state_features import stable_frames
from cophy.scenario import Scenario
from cophy.types import Batch, Inputs, Targets


def to_batch(arrays: dict[str, np.ndarray], scenario: Scenario) -> Batch:
    """Positions, presence and stability of experiments as they are stored; without confounders."""
    return frames_to_batch(frames_of(arrays, scenario), scenario)


def frames_of(arrays: dict[str, np.ndarray], scenario: Scenario) -> dict[str, np.ndarray]:
    """What batches are made of: one of the states for each frame.

    Args:
        arrays: Of experiments, as they are stored.
        scenario: Says how fast frames follow each other, and what stable means.

    Returns:
        The same but for `states` (experiment, 2, T, slot, 13), and with `stable` (experiment, 2, T-1, slot): whether an
        object is slow in all states from one frame to the next.
    """
    stride, states = scenario.clock.states_per_frame, arrays["states"]
    stable = [stable_frames(states[:, sequence], stride, scenario.task.stable_speed) for sequence in (0, 1)]
    present = arrays["presence"][:, :, None]
    return arrays | {"states": states[:, :, ::stride].copy(), "stable": np.stack(stable, axis=1) & present}


def frames_to_batch(arrays: dict[str, np.ndarray], scenario: Scenario) -> Batch:
    """The same as `to_batch`, of what `frames_of` leaves of the arrays."""
    inputs = _true_inputs(arrays)
    targets = Targets(
        position=_positions(arrays, 1)[:, 1:],
        stable=torch.from_numpy(arrays["stable"][:, 1]),
        presence=inputs.presence,
        initial=inputs.initial,
        observed_presence=inputs.observed_presence,
        confounder_class=confounder_classes(arrays, scenario.confounders),
        pair=torch.from_numpy(arrays["twin"].astype(np.int64)),
        cell=torch.from_numpy(arrays.get("cell", np.full(len(inputs), -1)).astype(np.int64)),
    )
    return Batch(inputs, targets)


def true_inputs(states: np.ndarray, presence: np.ndarray, scenario: Scenario) -> Inputs:
    """AB and C as they were; D is not looked at.

    Args:
        states: (experiment, 2, state, slot, 13) of AB and CD, as they are stored.
        presence: (experiment, 2, slot), which slots hold an object.
        scenario: Says what stable means, and how fast frames follow each other.
    """
    return _true_inputs(frames_of({"states": states, "presence": presence}, scenario))


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
    """AB and C as a de-renderer saw them.

    An object is in AB if most frames of AB show it, and in CD if C shows it. It counts as stable where it moves from
    frame to frame as slowly as stable objects do.

    Args:
        estimates: `position` (experiment, 2, T, slot, 3) in metres, and `presence_logit` (experiment, 2, T, slot).
        scenario: Says what stable means, and how fast frames follow each other.
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


def with_estimates(batch: Batch, estimates: dict[str, np.ndarray], scenario: Scenario) -> Batch:
    """Replace what a model sees by what a de-renderer saw.

    Args:
        batch: Experiments with true positions; what is to be predicted stays the truth.
        estimates: See `estimated_inputs`.
        scenario: Likewise.
    """
    seen = estimated_inputs(estimates, scenario)
    return replace(batch, inputs=replace(seen, confounders=batch.inputs.confounders))


def _positions(arrays: dict[str, np.ndarray], sequence: int) -> Tensor:
    return torch.from_numpy(arrays["states"][:, sequence, ..., :3].copy())


def _seems_stable(
    position: Float[Tensor, "batch time slots 3"], scenario: Scenario
) -> Bool[Tensor, "batch steps slots"]:
    speed = (position[:, 1:] - position[:, :-1]).norm(dim=-1) * scenario.clock.frame_rate_hz
    return speed < scenario.task.stable_speed
