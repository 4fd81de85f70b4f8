"""What only towers have: labels, and outcomes balanced for every value of every confounder (paper Sec. 3, Fig. 3)."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, none_wrong, tolerance
from cophy.dataset.audit.first_frames import geometry_of, slots_in_order
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.state_features import in_place, stands
from cophy.scenario.physics.statics import Combinations, TowerStatics
from cophy.scenario.search.settled import settled

MIN_SETTLED = 0.98  # ours: all, but stored geometry is rounded, and some combination may be at the edge


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
    yield from _statics(arrays, statics, standing)
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


def falls_from_on_paper(arrays: Arrays, statics: TowerStatics, sequence: int) -> tuple[np.ndarray, np.ndarray]:
    """From where towers fall by statics, from their stored geometry, under every combination of masses and gravity.

    Args:
        arrays: of the dataset.
        statics: of its scenario.
        sequence: 0 for A, 1 for C.

    Returns:
        (experiment, combination) see `TowerStatics.falls_from`; and whether the tower stands.
    """
    num_objects = _num_objects(arrays)
    combinations, tower = statics.combinations(num_objects), geometry_of(arrays, sequence, num_objects)
    xy, yaw = tower.position[..., :2], np.arctan2(tower.axis[..., 1], tower.axis[..., 0])
    levels = tower.presence.sum(axis=1)
    found = np.zeros((len(xy), len(combinations.mass)), dtype=np.int64)
    for count in np.unique(levels).tolist():
        rows = levels == count
        found[rows] = statics.falls_from(xy[rows, :count], yaw[rows, :count], combinations)
    return found, found == levels[:, None]


def _statics(arrays: Arrays, statics: TowerStatics, standing: np.ndarray) -> Iterator[Check]:
    """What statics say of the stored geometry: the stored outcomes, and that AB settles those of CD."""
    combinations = statics.combinations(_num_objects(arrays))
    slots = slots_in_order(arrays, _num_objects(arrays))
    mass = np.take_along_axis(arrays["mass"], slots, axis=1)
    own = combinations.find(Combinations(mass, arrays["gravity"][:, :2] / -statics.gravity_z))[:, None]
    (falls_from, stand), (_, counterfactual_stands) = (falls_from_on_paper(arrays, statics, s) for s in (0, 1))
    under_own = [np.take_along_axis(each, own, axis=1) for each in (stand, counterfactual_stands)]
    share = np.mean(np.concatenate(under_own, axis=1) == standing)
    yield Check("statics agree, under the stored masses and gravity", f"{share:.1%}", bool(share == 1))
    tells = np.take_along_axis(settled(falls_from, counterfactual_stands, combinations), own, axis=1).mean()
    yield Check("on paper AB tells whether C stands", f"{tells:.1%}", bool(tells >= MIN_SETTLED))
    # such a block tells its mass in AB, so it has to move
    sure = np.arange(slots.shape[1]) >= np.take_along_axis(falls_from, own, axis=1)
    stays = np.take_along_axis(in_place(arrays, statics.fallen_distance)[:, 0], slots, axis=1)
    fell = (sure <= ~stays).all(axis=1).mean()
    yield Check("in A all blocks fall that are sure to fall on paper", f"{fell:.1%}", bool(fell >= MIN_SETTLED))


def _stability(name: str, values: np.ndarray, standing: np.ndarray) -> Check:
    share = {float(value): float(standing[values == value].mean()) for value in np.unique(values)}
    passed = all(abs(s - 0.5) <= tolerance(0.5, (values == value).sum()) for value, s in share.items())
    return Check(f"CD stands, per {name}", "  ".join(f"{value:g}: {s:.1%}" for value, s in share.items()), passed)


def _num_objects(arrays: Arrays) -> int:
    return int((arrays["object_index"][0] >= 0).sum())
