"""What there is to be seen before anything moves, as features of a classifier."""

import numpy as np

from cophy.dataset.audit.checks import Arrays
from cophy.dataset.audit.first_frames import geometry_of


def initial_scene(arrays: Arrays, num_objects: int) -> np.ndarray:
    """(experiment, feature) everything visible in C, by object and by colour, and the do-operation.

    How two objects lie to each other is spelt out, distances and overhangs too: whether a block stands depends on how far it
    reaches beyond the sides of the one below, and trees find no such sum by themselves.
    """
    scene = geometry_of(arrays, 1, num_objects)
    first, second = np.triu_indices(num_objects, 1)
    both = (scene.presence[:, first] & scene.presence[:, second])[..., None]
    offset = (scene.position[:, second] - scene.position[:, first]) * both
    distance = np.linalg.norm(offset, axis=-1)
    overhangs = [_overhang(offset, scene.axis[:, side]) for side in (first, second)]
    by_colour = [arrays["states"][:, 1, 0, :, :3], arrays["shape"] * arrays["presence"][:, 1]]
    parts = [scene.position, scene.turn, scene.axis, scene.shape, offset, distance, *overhangs, *by_colour]
    return _flat([*parts, colours(arrays), do_operation(arrays), arrays["do_slot"], arrays["do_offset"]])


def do_operation(arrays: Arrays) -> np.ndarray:
    """(experiment, 2) its kind, and how far it displaces, metres."""
    return _flat([arrays["do_operation"], np.linalg.norm(arrays["do_offset"], axis=-1)])


def colours(arrays: Arrays) -> np.ndarray:
    """(experiment, feature) the place of each colour in the scenario's order (-1: not there), the one that the do-operation concerns too."""
    changed = np.take_along_axis(arrays["object_index"], arrays["do_slot"][:, None].astype(int), axis=1)
    return _flat([arrays["object_index"], changed])


def number_of_objects(arrays: Arrays) -> np.ndarray:
    """(experiment, 1) number of objects in C."""
    return _flat([arrays["presence"][:, 1].sum(axis=1)])


def _overhang(offset: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(experiment, pair) the larger part of an offset along and across an object's axis, horizontally; 0 for spheres."""
    along = np.abs((offset * axis)[..., :2].sum(axis=-1))
    across = np.abs(offset[..., 0] * axis[..., 1] - offset[..., 1] * axis[..., 0])
    return np.maximum(along, across)


def _flat(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([part.reshape(len(part), -1).astype(np.float32) for part in parts], axis=1)
