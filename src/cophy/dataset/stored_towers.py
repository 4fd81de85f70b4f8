"""Stored towers as statics sees them: blocks from the ground up."""

from typing import NamedTuple

import numpy as np


class StoredTowers(NamedTuple):
    """The towers of A (sequence 0) and C (1), and what they are made of.

    xy: (experiment, 2, level, 2) block centres at t = 0, metres; yaw: (experiment, 2, level), rad. num_levels:
    (experiment, 2), fewer in a C whose top block is removed: levels above mean nothing.
    mass: (experiment, level), kg; tilt: (experiment, 2), horizontal over vertical gravity.
    """

    xy: np.ndarray
    yaw: np.ndarray
    num_levels: np.ndarray
    mass: np.ndarray
    tilt: np.ndarray


def stored_towers(arrays: dict[str, np.ndarray], num_objects: int) -> StoredTowers:
    """The towers of a dataset's experiments, with `num_objects` blocks in A."""
    index = np.where(arrays["object_index"] < 0, num_objects, arrays["object_index"])
    levels = index.argsort(axis=1)[:, :num_objects]
    initial = np.take_along_axis(arrays["states"][:, :, 0], levels[:, None, :, None], axis=2)
    return StoredTowers(
        xy=initial[..., :2],
        yaw=2 * np.arctan2(initial[..., 5], initial[..., 6]),
        num_levels=arrays["presence"].sum(axis=2),
        mass=np.take_along_axis(arrays["mass"], levels, axis=1),
        tilt=arrays["gravity"][:, :2] / -arrays["gravity"][:, 2:],
    )
