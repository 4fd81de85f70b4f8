"""What the files of one experiment say, in the scenario's colour slots, and whether it can be true."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cophy.dataset.fields import CONFOUNDERS_OF_OBJECTS
from cophy.scenario import Scenario

# ours, in the unit of each confounder (kg, m/s²; friction and restitution have none). Released values are 0.4 or more
# apart, and their noise is below 0.001 (0.0997877 for 0.1)
SNAP_TOLERANCE = 0.02
UNIT_TOLERANCE = 0.01  # ours: how far a quaternion's length may be from 1
LARGEST = 1e4  # ours, in m, m/s and rad/s: hundreds of times what happens in any scenario


class BrokenExperimentError(Exception):
    """An experiment contradicts itself or its format; the message says how."""


@dataclass
class Recording:
    """One experiment at the frame rate.

    states: AB and CD (2, T, slot, 13), absent objects zero. shape: (slot,) codes of `Shape`. order: (slot,) place from
    bottom to top or in the files, -1 where empty. mass, friction, restitution: (slot,), NaN where the files do not tell.
    gravity_xy: (2,) m/s², likewise. clip_frames: of AB's and CD's RGB clip, 0 where there is none.
    """

    states: np.ndarray
    shape: np.ndarray
    order: np.ndarray
    mass: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    gravity_xy: np.ndarray
    clip_frames: tuple[int, int]


def to_row(recording: Recording, scenario: Scenario, num_objects: int) -> dict[str, Any]:
    """The arrays of one experiment, as `ReleasedStates` has them.

    Args:
        recording: what its files say.
        scenario: as which it is read.
        num_objects: that A must hold.

    Raises:
        BrokenExperimentError: it cannot be true.
    """
    presence = _presence(recording.states)
    if (largest := np.abs(recording.states).max()) > LARGEST:
        raise BrokenExperimentError(f"states.npy holds {largest:g}: no object gets so far, or so fast")
    if presence[0].sum() != num_objects:
        raise BrokenExperimentError(f"AB holds {presence[0].sum()} objects, not {num_objects}")
    if not presence[1].any() or (presence[1] & ~presence[0]).any():
        raise BrokenExperimentError("CD holds objects that AB does not, or none")
    length = np.linalg.norm(recording.states[..., 3:7], axis=-1).swapaxes(1, 2)[presence]
    if np.abs(length - 1).max() > UNIT_TOLERANCE:
        raise BrokenExperimentError("columns 3 to 6 of states.npy are not unit quaternions")
    grid = scenario.confounders
    slot, offset = _do_operation(recording.states, presence)
    return {
        "states": recording.states,
        "presence": presence,
        "shape": np.where(presence[0], recording.shape, 0),
        "object_index": np.where(presence[0], recording.order, -1),
        **{
            name: _snapped(name, getattr(recording, name), getattr(grid, name), presence[0])
            for name in CONFOUNDERS_OF_OBJECTS
        },
        "gravity": (*_gravity(recording.gravity_xy, scenario), scenario.gravity_z),
        "do_slot": slot,
        "do_offset": offset,
        "clip": np.array(recording.clip_frames) > 0,
    }


def _presence(states: np.ndarray) -> np.ndarray:
    """(2, slot): an absent object is zero at every time; one that comes or goes is refused."""
    there = (states != 0).any(axis=-1)
    if (there.any(axis=1) != there.all(axis=1)).any():
        raise BrokenExperimentError("an object is zero in some frames and not in others")
    return there[:, 0]


def _snapped(name: str, values: np.ndarray, grid: list[float], present: np.ndarray) -> np.ndarray:
    """Values of present objects, moved to the grid. One that is further than SNAP_TOLERANCE from it is refused."""
    nearest = _nearest(values, grid)
    off = present & (np.abs(values - nearest) > SNAP_TOLERANCE)
    if off.any():
        listed = ", ".join(f"{value:g}" for value in grid)
        raise BrokenExperimentError(f"{name} {values[off][0]:g} is not among {listed}: see scenario.confounders.{name}")
    return np.where(present, np.where(np.isnan(values), np.nan, nearest), 0.0)


def _nearest(values: np.ndarray, grid: list[float]) -> np.ndarray:
    return np.array(grid, dtype=float)[np.abs(values[:, None] - np.array(grid)).argmin(axis=1)]


def _gravity(gravity_xy: np.ndarray, scenario: Scenario) -> np.ndarray:
    """(2,) on the grid. NaN where the files hold other values: these may be no gravity at all."""
    grids = (scenario.confounders.gravity_x, scenario.confounders.gravity_y)
    nearest = [_nearest(np.array([value]), grid)[0] for value, grid in zip(gravity_xy, grids, strict=True)]
    on_grid = np.abs(gravity_xy - nearest).max() <= SNAP_TOLERANCE
    return np.array(nearest) if on_grid else np.full(2, np.nan)


def _do_operation(states: np.ndarray, presence: np.ndarray) -> tuple[int, np.ndarray]:
    """The slot that C changes most, and by how much (m); a removed one is not displaced."""
    removed = np.flatnonzero(presence[0] & ~presence[1])
    if len(removed):
        return int(removed[0]), np.zeros(3)
    offset = states[1, 0, :, :3] - states[0, 0, :, :3]
    slot = int(np.linalg.norm(offset, axis=-1).argmax())
    return slot, offset[slot]
