"""What follows from stored states: how objects are turned, which are stable, and what becomes of them."""

import numpy as np

from cophy.scenario import Shape
from cophy.scenario.physics.orientation import x_axis, z_axis

Arrays = dict[str, np.ndarray]


def visible_axis(quaternion_xyzw: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(experiment, slot, 3) direction of a cylinder's axis (its sign chosen so that x ≥ 0) or of a block's own x axis.

    quaternion_xyzw: (experiment, slot, 4). shape: (experiment, slot), codes of `Shape`. Zero for spheres and empty slots.
    """
    along_x, along_z, kind = x_axis(quaternion_xyzw), z_axis(quaternion_xyzw), shape[..., None]
    unsigned = np.where(along_z[..., :1] < 0, -along_z, along_z)
    return np.where(kind == Shape.CYLINDER, unsigned, np.where(kind == Shape.BOX, along_x, 0.0))


def stable_frames(states: np.ndarray, stride: int, stable_speed: float) -> np.ndarray:
    """Which objects are stable in which frames.

    Args:
        states: (experiment, state, slot, 13) position, quaternion xyzw, linear and angular velocity.
        stride: states per frame.
        stable_speed: an object slower than this is stable, m/s.

    Returns:
        (experiment, frame 1 ... T-1, slot) bool: slow at every state after the frame before, up to and with this frame.
    """
    slow = np.linalg.norm(states[..., 7:10], axis=-1) < stable_speed
    num_frames = slow.shape[1] // stride
    after_first = slow[:, 1 : (num_frames - 1) * stride + 1]
    return np.asarray(after_first.reshape(len(slow), num_frames - 1, stride, -1).all(axis=2))


def in_place(arrays: Arrays, distance_m: float) -> np.ndarray:
    """(experiment, sequence, slot) whether the object was always nearer than this to where it started."""
    return np.asarray(_from_start(arrays).max(axis=2) < distance_m)


def stands(arrays: Arrays, fallen_distance: float) -> np.ndarray:
    """(experiment, sequence) whether no block of a tower left its place by `fallen_distance` metres."""
    return np.asarray(in_place(arrays, fallen_distance).all(axis=2))


def mean_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence, slot) how far the object is from where it started, averaged over time, metres."""
    return np.asarray(_from_start(arrays).mean(axis=2))


def objects_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) mean of `mean_distance` over the objects that are there."""
    present = arrays["presence"]
    return np.asarray((mean_distance(arrays) * present).sum(axis=2) / present.sum(axis=2).clip(min=1))


def further_than_twin(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) whether objects move further, on average, than under the twin's confounders."""
    moved = objects_distance(arrays)
    _, pair = np.unique(arrays["twin"], return_inverse=True)
    of_pair = np.stack([np.bincount(pair, weights=m)[pair] / np.bincount(pair)[pair] for m in moved.T], axis=1)
    return np.asarray(moved > of_pair)


def _from_start(arrays: Arrays) -> np.ndarray:
    position = arrays["states"][..., :3]
    return np.asarray(np.linalg.norm(position - position[:, :, :1], axis=-1))
