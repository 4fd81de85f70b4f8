"""What only towers have: labels, and outcomes balanced for every value of every confounder (paper Sec. 3, Fig. 3)."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, none_wrong, tolerance
from cophy.dataset.audit.first_frames import geometry_of, slots_in_order
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.state_features import stands
from cophy.scenario.physics.statics import TowerStatics

AGREEMENT_TOLERANCE = 0.02  # stored geometry is rounded


def towers(arrays: Arrays, spec: DatasetSpec, statics: TowerStatics) -> Iterator[Check]:
    """Labels against the trajectories, and stability of CD per value of each confounder (paper Fig. 3).

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        statics: of its scenario.
    """
    standing = stands(arrays, statics.fallen_distance)
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    right = _cells(standing) == names
    yield Check("cells agree with the trajectories", f"{right.mean():.1%}", bool(right.all()))
    alike = standing[::2] == standing[1::2]
    yield none_wrong("twins have opposite outcomes of CD", (2 * np.flatnonzero(alike[:, 1])).tolist())
    stand_twice = np.flatnonzero(alike[:, 0] & standing[::2, 0])
    yield none_wrong("no A stands under both twins' confounders", (2 * stand_twice).tolist())
    yield _statics(arrays, statics, standing)
    yield _agreement(arrays, statics, names)
    yield from stability_per_value(arrays, standing[:, 1], spec.num_objects)


def _cells(standing: np.ndarray) -> np.ndarray:
    """(experiment,) names of the cells that trajectories belong to."""
    words = np.where(standing, "stands", "falls")
    both_fall = np.repeat(~standing[::2, 0] & ~standing[1::2, 0], 2)
    return np.char.add(np.char.add(np.where(both_fall, "both_fall", words[:, 0]), "_"), words[:, 1])


def stability_per_value(arrays: Arrays, standing: np.ndarray, num_objects: int) -> Iterator[Check]:
    """Whether half of the towers stand for each value of each confounder that is known (paper Fig. 3).

    Args:
        arrays: of the dataset.
        standing: (experiment,) whether the tower of CD stands.
        num_objects: blocks in A.
    """
    values = {name: (arrays["gravity"][:, axis]) for axis, name in enumerate(("gravity_x", "gravity_y"))}
    for level in range(num_objects):
        slot = arrays["object_index"] == level
        values |= {f"{name} of block {level}": arrays[name][slot] for name in ("mass", "friction")}
    for name, found in values.items():
        if not np.isnan(found).any():
            yield _stability(name, found, standing)


def stand_on_paper(arrays: Arrays, statics: TowerStatics, sequence: int) -> np.ndarray:
    """Which towers stand by statics, from their stored geometry.

    Args:
        arrays: of the dataset.
        statics: of its scenario.
        sequence: 0 for A, 1 for C.

    Returns:
        (experiment, combination) bool, under every combination of masses and gravity.
    """
    num_objects = _num_objects(arrays)
    combinations, tower = statics.combinations(num_objects), geometry_of(arrays, sequence, num_objects)
    xy, yaw = tower.position[..., :2], np.arctan2(tower.axis[..., 1], tower.axis[..., 0])
    levels = tower.presence.sum(axis=1)
    found = np.zeros((len(xy), len(combinations.mass)), dtype=bool)
    for count in np.unique(levels).tolist():
        rows = levels == count
        found[rows] = statics.margins(xy[rows, :count], yaw[rows, :count], combinations) > 0
    return found


def _statics(arrays: Arrays, statics: TowerStatics, standing: np.ndarray) -> Check:
    """Every tower, of AB and of CD, stands or falls as statics say of its stored geometry under its own confounders."""
    num_objects = _num_objects(arrays)
    mass, gravity_xy = statics.grid.masses_and_gravities(num_objects)
    slots = slots_in_order(arrays, num_objects)
    own = np.concatenate([np.take_along_axis(arrays["mass"], slots, axis=1), arrays["gravity"][:, :2]], axis=1)
    column = np.abs(own[:, None] - np.concatenate([mass, gravity_xy], axis=1)).sum(axis=-1).argmin(axis=1)
    on_paper = [stand_on_paper(arrays, statics, sequence) for sequence in (0, 1)]
    under_own = [np.take_along_axis(stand, column[:, None], axis=1)[:, 0] for stand in on_paper]
    share = np.mean(np.stack(under_own, axis=1) == standing)
    return Check("statics agree, under the stored masses and gravity", f"{share:.1%}", bool(share == 1))


def _agreement(arrays: Arrays, statics: TowerStatics, names: np.ndarray) -> Check:
    """Whether a standing AB says much about CD, by statics from the stored geometry.

    For experiments whose A stands: of all combinations under which A stands, the share under which C has the true
    outcome. Where it is below 1, a standing AB makes the true CD likely, not certain.
    names: (experiment,) of the cells.
    """
    rows = np.char.startswith(names, "stands")
    observed, counterfactual = (stand_on_paper(arrays, statics, sequence)[rows] for sequence in (0, 1))
    outcome = np.char.endswith(names[rows], "stands")[:, None]
    shares = (observed & (counterfactual == outcome)).sum(axis=1) / observed.sum(axis=1).clip(min=1)
    found = f"mean {shares.mean():.1%}, least {shares.min():.1%}, certain in {(shares == 1).mean():.1%}"
    sound = bool(shares.min() >= statics.min_agreement - AGREEMENT_TOLERANCE)
    return Check("a standing AB speaks for the true CD", found, sound)


def _stability(name: str, values: np.ndarray, standing: np.ndarray) -> Check:
    share = {float(value): float(standing[values == value].mean()) for value in np.unique(values)}
    passed = all(abs(s - 0.5) <= tolerance(0.5, (values == value).sum()) for value, s in share.items())
    return Check(f"CD stands, per {name}", "  ".join(f"{value:g}: {s:.1%}" for value, s in share.items()), passed)


def _num_objects(arrays: Arrays) -> int:
    return int((arrays["object_index"][0] >= 0).sum())
