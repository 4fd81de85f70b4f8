"""What a first frame shows: where objects are, how they are turned, and which shape they have, whatever their colours."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from cophy.dataset.audit.checks import Arrays, Check
from cophy.dataset.state_features import visible_axis
from cophy.scenario import Shape

# ours: metres, and the same for turns (see `Geometry`), so a copy however it was rounded. Independent scenes come as near as
# that in a few of a hundred datasets of 20,000 collisions (nearest of 4,000: 2 mm; of 16,000: 0.6 mm), others never
SAME_TOLERANCE_M = 1e-4
ABSENT_M = 1e3  # what is not there is this far from anything


@dataclass(frozen=True)
class Geometry:
    """First frames, objects in the scenario's own order (towers: bottom to top).

    position: (experiment, object, 3), metres. turn: (experiment, object, 2), equal where objects look equal: cos and sin of
    4 × the yaw of a block, of 2 × the direction of a cylinder's axis (0 where it stands); 0 for spheres. axis: (experiment,
    object, 3), see `visible_axis`. shape, presence: (experiment, object).
    """

    position: np.ndarray
    turn: np.ndarray
    axis: np.ndarray
    shape: np.ndarray
    presence: np.ndarray


def geometry_of(arrays: Arrays, sequence: int, num_objects: int) -> Geometry:
    """First frames of all experiments.

    Args:
        arrays: of the dataset.
        sequence: 0 for A, 1 for C.
        num_objects: in A.
    """
    order = slots_in_order(arrays, num_objects)
    state = np.take_along_axis(arrays["states"][:, sequence, 0], order[..., None], axis=1).astype(np.float64)
    shape, presence = (
        np.take_along_axis(values, order, axis=1) for values in (arrays["shape"], arrays["presence"][:, sequence])
    )
    shape = shape * presence
    axis = visible_axis(state[..., 3:7], shape)
    turn = (axis[..., 0] + 1j * axis[..., 1]) ** np.where(shape == Shape.BOX, 4, 2)
    return Geometry(state[..., :3], np.stack([turn.real, turn.imag], axis=-1), axis, shape, presence)


def slots_in_order(arrays: Arrays, num_objects: int) -> np.ndarray:
    """(experiment, object) the slot of each object of A, in the scenario's own order."""
    place = np.where(arrays["object_index"] < 0, num_objects, arrays["object_index"])
    return np.argsort(place, axis=1, kind="stable")[:, :num_objects]


def geometries(arrays: Arrays, num_objects: int) -> Iterator[Check]:
    """No first frame, A or C, of one split looks like one of another, whatever its colours."""
    features = np.concatenate([_features(geometry_of(arrays, sequence, num_objects)) for sequence in (0, 1)])
    rows, split = np.tile(np.arange(len(arrays["split"])), 2), np.tile(arrays["split"], 2)
    finite = np.isfinite(features).all(axis=1)
    features, rows, split = features[finite], rows[finite], split[finite]
    nearest, between = np.inf, (0, 0)
    for one in np.unique(split)[1:]:
        here, there = np.flatnonzero(split == one), np.flatnonzero(split < one)
        distance, index = KDTree(features[there]).query(features[here], p=np.inf)
        least = distance.argmin()
        if distance[least] < nearest:
            nearest, between = float(distance[least]), (int(rows[here[least]]), int(rows[there[index[least]]]))
    found = f"nearest {nearest:.1e} m > {SAME_TOLERANCE_M:g} m (experiments {between[0]} and {between[1]})"
    yield Check("no A or C of one split in another", found, nearest > SAME_TOLERANCE_M)


def _features(geometry: Geometry) -> np.ndarray:
    """(experiment, feature): every coordinate sorted over objects by itself.

    Objects that look alike, in whatever order, have near features: sorting never takes values further apart.
    """
    there = geometry.presence[..., None]
    features = np.concatenate([geometry.position, geometry.turn, geometry.shape[..., None]], axis=-1)
    return np.sort(np.where(there, features, ABSENT_M), axis=1).reshape(len(features), -1)
