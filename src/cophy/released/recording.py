"""One released experiment: its content, and checks that it is consistent."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cophy.dataset.states import CONFOUNDERS_OF_OBJECTS, MAX_STATE
from cophy.scenario import Scenario
from cophy.scenario.confounders import ConfounderGrid
from cophy.untrusted_files import BrokenFileError

# ours, in the unit of each confounder (kg, m/s²; friction and restitution have none). Released values are 0.4 or more
# apart, and their noise is below 0.001 (0.0997877 for 0.1)
SNAP_TOLERANCE = 0.02
UNIT_TOLERANCE = 0.01  # ours: how far the norm of a quaternion may be from 1


@dataclass
class Recording:
    """One experiment at the frame rate.

    Attributes:
        states: (2, T, slot, 13) AB and CD, absent objects zero.
        shape: (slot,) codes of `Shape`.
        order: (slot,) place from bottom to top or in the files, -1 where empty.
        confounders: (slot, 3) mass (kg), friction, restitution; NaN where the files do not contain them.
        gravity_xy: (2,) m/s², NaN likewise.
        has_clips: whether AB and CD have RGB clips.
    """

    states: np.ndarray
    shape: np.ndarray
    order: np.ndarray
    confounders: np.ndarray
    gravity_xy: np.ndarray
    has_clips: list[bool]


def to_row(recording: Recording, scenario: Scenario, num_objects: int) -> dict[str, Any]:
    """Return the arrays of one experiment, as `ReleasedStates` has them. num_objects: the number that A must hold.

    Raises:
        BrokenFileError: the experiment is inconsistent.
    """
    presence = _presence(recording.states)
    if (largest := np.abs(recording.states).max()) > MAX_STATE:
        raise BrokenFileError(f"states.npy holds {largest:g}, which is more than {MAX_STATE:g}")
    if presence[0].sum() != num_objects:
        raise BrokenFileError(f"AB holds {presence[0].sum()} objects, not {num_objects}")
    if not presence[1].any() or (presence[1] & ~presence[0]).any():
        raise BrokenFileError("CD holds objects that AB does not, or none")
    norm = np.linalg.norm(recording.states[..., 3:7], axis=-1).swapaxes(1, 2)[presence]
    if np.abs(norm - 1).max() > UNIT_TOLERANCE:
        raise BrokenFileError("columns 3 to 6 of states.npy are not unit quaternions")
    grid = scenario.confounders
    confounders = {
        name: _snap(name, values, getattr(grid, name), presence[0])
        for name, values in zip(CONFOUNDERS_OF_OBJECTS, recording.confounders.T, strict=True)
    }
    slot, offset = _do_operation(recording.states, presence)
    return {
        "states": recording.states,
        "presence": presence,
        "shape": np.where(presence[0], recording.shape, 0),
        "object_index": np.where(presence[0], recording.order, -1),
        **confounders,
        "gravity": (*_snap_gravity(recording.gravity_xy, grid), scenario.gravity_z),
        "do_slot": slot,
        "do_offset": offset,
        "clip": recording.has_clips,
    }


def _presence(states: np.ndarray) -> np.ndarray:
    """Return which objects are present, (2, slot): absent ones are zero at every time, and none comes or goes."""
    nonzero = (states != 0).any(axis=-1)
    if (nonzero.any(axis=1) != nonzero.all(axis=1)).any():
        raise BrokenFileError("an object is zero in some frames and not in others")
    return nonzero[:, 0]


def _snap(name: str, values: np.ndarray, grid: list[float], present: np.ndarray) -> np.ndarray:
    """Move values of present objects to the grid, and refuse one that is farther than SNAP_TOLERANCE from it."""
    nearest = _nearest(values, grid)
    wrong = present & (np.abs(values - nearest) > SNAP_TOLERANCE)
    if wrong.any():
        listed = f"{values[wrong][0]:g} is not among {', '.join(f'{value:g}' for value in grid)}"
        raise BrokenFileError(f"{name} {listed}: see scenario.confounders.{name}")
    return np.where(present, np.where(np.isnan(values), np.nan, nearest), 0.0)


def _snap_gravity(gravity_xy: np.ndarray, grid: ConfounderGrid) -> np.ndarray:
    """Return (2,) on the grid, or NaN where the files hold other values, which may not be gravity at all."""
    nearest = np.concatenate([_nearest(gravity_xy[:1], grid.gravity_x), _nearest(gravity_xy[1:], grid.gravity_y)])
    is_on_grid = np.abs(gravity_xy - nearest).max() <= SNAP_TOLERANCE
    return nearest if is_on_grid else np.full(2, np.nan)


def _nearest(values: np.ndarray, grid: list[float]) -> np.ndarray:
    return np.array(grid, dtype=float)[np.abs(values[:, None] - np.array(grid)).argmin(axis=1)]


def _do_operation(states: np.ndarray, presence: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the slot that C changes most, and its displacement (m); zero if it is removed."""
    removed = np.flatnonzero(presence[0] & ~presence[1])
    if len(removed):
        return int(removed[0]), np.zeros(3)
    offset = states[1, 0, :, :3] - states[0, 0, :, :3]
    slot = int(np.linalg.norm(offset, axis=-1).argmax())
    return slot, offset[slot]
