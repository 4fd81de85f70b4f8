"""Quantities computed from stored states: how far objects move, whether towers stand, and how hard each experiment is.

An experiment is hard if its outcome is close to another one, or if its confounders are hard to tell or matter little.
"""

import numpy as np

from cophy.dataset.shards import Arrays
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import slots_in_order
from cophy.scenario.statics import joint_margins


def in_place(arrays: Arrays, distance_m: float) -> np.ndarray:
    """Return whether each object stays closer than this to its start, (experiment, sequence, slot)."""
    return np.asarray(_from_start(arrays).max(axis=2) < distance_m)


def stands(arrays: Arrays, fallen_distance: float) -> np.ndarray:
    """Return whether no block of a tower moves by `fallen_distance` metres, (experiment, sequence)."""
    return np.asarray(in_place(arrays, fallen_distance).all(axis=2))


def mean_distance(arrays: Arrays) -> np.ndarray:
    """Return each object's distance from its start, averaged over time, (experiment, sequence, slot) metres."""
    return np.asarray(_from_start(arrays).mean(axis=2))


def objects_distance(arrays: Arrays) -> np.ndarray:
    """Return the mean of `mean_distance` over the objects that are present, (experiment, sequence)."""
    present = arrays["presence"]
    return np.asarray((mean_distance(arrays) * present).sum(axis=2) / present.sum(axis=2).clip(min=1))


def further_than_twin(arrays: Arrays) -> np.ndarray:
    """Return whether objects move further, on average, than under the twin's confounders, (experiment, sequence)."""
    moved = objects_distance(arrays)
    _, pair = np.unique(arrays["twin"], return_inverse=True)
    pair_mean = np.stack([np.bincount(pair, weights=m)[pair] / np.bincount(pair)[pair] for m in moved.T], axis=1)
    return np.asarray(moved > pair_mean)


def _from_start(arrays: Arrays) -> np.ndarray:
    position = arrays["states"][..., :3]
    return np.asarray(np.linalg.norm(position - position[:, :, :1], axis=-1))


def difficulty(arrays: Arrays, spec: DatasetSpec) -> Arrays:
    """Return (experiment,) values by name, for a whole dataset (`sort_by_twins`).

    - cell, do_operation: names of the cell and of the kind of do-operation.
    - twins (if twins have different cells): names of both twins' cells.
    - displacement: distance by which the do-operation moves its object, metres; NaN if it removes one.
    - observed_difference, counterfactual_difference: distance of AB, or CD, from the twin's, metres. A small observed one
      makes the confounders hard to tell; a small counterfactual one makes them matter little.
    - observed_margin, counterfactual_margin (towers): by statics under the true confounders, distance of the centre of
      mass of A, or C, from the tipping point, metres. For falling towers it is a lower bound. Small values are hard.
    """
    removed = arrays["presence"][:, 0].sum(axis=1) > arrays["presence"][:, 1].sum(axis=1)
    observed, counterfactual = np.repeat(twin_differences(arrays), 2, axis=0).T
    values = {
        "cell": np.array(spec.scenario.cells())[arrays["cell"]],
        "do_operation": np.array(spec.scenario.do_operations)[arrays["do_operation"]],
        "displacement": np.where(removed, np.nan, np.linalg.norm(arrays["do_offset"], axis=1)),
        "observed_difference": observed,
        "counterfactual_difference": counterfactual,
    }
    cells = values["cell"].reshape(-1, 2)
    if (cells[:, 0] != cells[:, 1]).any():
        values["twins"] = np.repeat([" or ".join(sorted(pair)) for pair in cells.tolist()], 2)
    if spec.scenario.statics is not None:
        margins = np.abs(true_margins(arrays, spec))
        values |= {"observed_margin": margins[:, 0], "counterfactual_margin": margins[:, 1]}
    return values


def twin_differences(arrays: Arrays) -> np.ndarray:
    """Return the distance between the AB, and between the CD, of twins, (pair, 2) metres.

    As in `trajectory_distance`, it is averaged over time, for the object that differs most.
    """
    apart = arrays["states"][::2, ..., :3] - arrays["states"][1::2, ..., :3]
    distance = np.linalg.norm(apart, axis=-1).mean(axis=2)
    return np.asarray(np.where(arrays["presence"][::2], distance, 0.0).max(axis=-1))


def true_margins(arrays: Arrays, spec: DatasetSpec) -> np.ndarray:
    """Return the margins (see `TowerStatics.margins`) of A and C under the true confounders, (experiment, 2) metres.

    A tower with a positive margin stands.
    """
    levels = slots_in_order(arrays, spec.num_objects)  # from the ground up; C may have one block less
    initial = np.take_along_axis(arrays["states"][:, :, 0], levels[:, None, :, None], axis=2)
    xy, yaw = initial[..., :2], 2 * np.arctan2(initial[..., 5], initial[..., 6])
    mass = np.take_along_axis(arrays["mass"], levels, axis=1)
    tilt = arrays["gravity"][:, :2] / -arrays["gravity"][:, 2:]  # horizontal over vertical gravity
    num_levels = arrays["presence"].sum(axis=2)
    margins = np.empty(num_levels.shape)
    for sequence in (0, 1):
        for k in np.unique(num_levels[:, sequence]).tolist():
            rows = np.flatnonzero(num_levels[:, sequence] == k)
            confounders, index = np.unique(np.hstack([mass[rows, :k], tilt[rows]]), axis=0, return_inverse=True)
            blocks = xy[rows, sequence, :k], yaw[rows, sequence, :k]
            size_m = spec.scenario.object_size_m
            margins_of_all = joint_margins(*blocks, confounders[:, :k], confounders[:, k:], size_m=size_m).min(axis=-1)
            margins[rows, sequence] = margins_of_all[np.arange(len(rows)), index]
    return margins
