"""What becomes of the objects of a sequence, in numbers that can be compared."""

import numpy as np

from cophy.dataset.audit.check import Arrays


def in_place(arrays: Arrays, distance_m: float) -> np.ndarray:
    """(experiment, sequence, slot) whether the object was always nearer than this to where it started."""
    return np.asarray(_from_start(arrays).max(axis=2) < distance_m)


def stands(arrays: Arrays, fallen_distance: float) -> np.ndarray:
    """(experiment, sequence) whether no block left its place."""
    return np.asarray(in_place(arrays, fallen_distance).all(axis=2))


def mean_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence, slot) how far the object is from where it started, averaged over time, metres."""
    return np.asarray(_from_start(arrays).mean(axis=2))


def further_than_twin(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) whether objects move further, on average, than under the twin's confounders."""
    moved = objects_distance(arrays)
    _, pair = np.unique(arrays["twin"], return_inverse=True)
    of_pair = np.stack([np.bincount(pair, weights=m)[pair] / np.bincount(pair)[pair] for m in moved.T], axis=1)
    return np.asarray(moved > of_pair)


def objects_distance(arrays: Arrays) -> np.ndarray:
    """(experiment, sequence) mean of `mean_distance` over the objects that are there."""
    present = arrays["presence"]
    return np.asarray((mean_distance(arrays) * present).sum(axis=2) / present.sum(axis=2).clip(min=1))


def _from_start(arrays: Arrays) -> np.ndarray:
    position = arrays["states"][..., :3]
    return np.asarray(np.linalg.norm(position - position[:, :, :1], axis=-1))
