"""Checks of a dataset's arrays: every check is one line of an audit.

The checks (see docs/benchmark/data_quality.md): states of rigid bodies, twins and splits, frequencies (paper Sec. 3: balanced and
bias free), effects of do-operations, first frames, and outcomes of towers (paper Fig. 3).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import ks_2samp

from cophy.dataset.difficulty import in_place, mean_distance, stands, twin_differences
from cophy.dataset.shards import Arrays, Sharded
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import (
    CONFOUNDERS_OF_OBJECTS,
    build_scene,
    do_operation_of,
    slots_in_order,
    trajectories_of,
    visible_axis,
)
from cophy.scenario import Scenario, Shape
from cophy.scenario.assignment import canonical_problems
from cophy.scenario.physics import Scene, largest_energy_gain
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.statics import Combinations, TowerStatics
from cophy.scenario.towers import is_identifiable

BALANCE_TOLERANCE = 0.05  # paper Sec. 3: 50 ± 5 % of the counterfactual outcomes are stable
# ours: Kolmogorov-Smirnov distance. Heavy objects travel less (0.55 for struck objects), but no value should determine the
# distance
MAX_KS_DISTANCE = 0.65
EFFECT_ROUNDING_M = 1e-4  # stored states are rounded
# ours: metres, and the same for rotations (see `Geometry`), so a copy however it was rounded. Independent scenes come this
# near in a few of a hundred datasets of 20,000 collisions (nearest of 4,000: 2 mm; of 16,000: 0.6 mm), others never
SAME_SCENE_M = 1e-4
ABSENT_M = 1e3  # absent objects are placed this far from all others
ROUNDING_TOLERANCE_M = 1e-5  # float32
# share of an object's size: Bullet needs it to turn the fastest balls (docs/benchmark/data_quality.md)
MAX_PENETRATION = 0.05
# ours: share of the initial energy, between two states, where the scenario has no `max_energy_gain`. Of 16,000 sequences of three
# blocks, five gain 1.2 to 1.6 % in an impact
MAX_ENERGY_GAIN = 0.02
MIN_SETTLED = 0.98  # ours: not 1, because stored geometry is rounded and some combination may be at the edge
SCENE_OF_TWINS = ("twin", "split", "shape", "object_index", "presence", "background_seed")
SHARED_BY_TWINS = (*SCENE_OF_TWINS, "do_operation", "do_slot", "do_offset")


@dataclass(frozen=True)
class Check:
    """One line of an audit: what was checked, the result, and whether it passed."""

    name: str
    result: str
    passed: bool


def three_sigma(share: float, draws: int) -> float:
    """Return three standard deviations of a share among `draws` independent draws; 1 without any draw."""
    return 3 * float(np.sqrt(share * (1 - share) / draws)) if draws else 1.0


def tolerance(share: float, draws: int) -> float:
    """Return BALANCE_TOLERANCE, or three standard deviations where that is more (tiny datasets)."""
    return max(BALANCE_TOLERANCE, three_sigma(share, draws))


def check_all(name: str, wrong: list[int], arrays: Arrays) -> Check:
    """Check that every experiment passes, given the rows of those that do not."""
    result = f"fails in {len(wrong)} experiments, the first is {arrays['experiment'][wrong[0]]}" if wrong else "yes"
    return Check(name, result, not wrong)


def check_states(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Check that states are those of rigid bodies in this scene: finite, apart, in view, without gaining energy."""
    finite = bool(np.isfinite(arrays["states"]).all())
    unused = [arrays[name][arrays["object_index"] < 0] for name in CONFOUNDERS_OF_OBJECTS]
    unused.append(arrays["states"].swapaxes(2, 3)[~arrays["presence"]])
    passed = finite and not any(values.any() for values in unused)
    yield Check("states are finite, empty slots zero", "yes" if passed else "no", passed)
    yield _check_configurations(arrays, spec)
    if finite:
        yield _check_do_operations(arrays)
        yield from check_positions(arrays, spec.scenario.object_size_m)
        if isinstance(spec.scenario, SimulatedSearch):
            yield _check_in_view(arrays, spec.scenario)
        yield _check_energy(arrays, spec)


def _check_configurations(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Check that masses, frictions, restitutions and gravity are those of the configuration, in the scenario's order."""
    wrong, slots = [], slots_in_order(arrays, spec.num_objects)
    for row, configuration in enumerate(arrays["configuration"].tolist()):
        true = spec.scenario.confounders.decode(configuration, spec.num_objects)
        stored = [arrays[name][row, slots[row]] for name in CONFOUNDERS_OF_OBJECTS]
        same = np.allclose(stored, [true.mass, true.friction, true.restitution])
        if not same or not np.allclose(arrays["gravity"][row], (*true.gravity_xy, spec.scenario.gravity_z)):
            wrong.append(row)
    return check_all("confounders match the configuration", wrong, arrays)


def _check_do_operations(arrays: Arrays) -> Check:
    """Check that C differs from A by the do-operation and by nothing else."""
    wrong = []
    for row, (first, second) in enumerate(arrays["states"][:, :, 0, :, :7].astype(np.float64)):
        expected, presence = first.copy(), arrays["presence"][row, 0].copy()
        slot = int(arrays["do_slot"][row])
        expected[slot, :3] += arrays["do_offset"][row]
        if not arrays["presence"][row, 1, slot]:
            expected[slot], presence[slot] = 0.0, False
        same = (presence == arrays["presence"][row, 1]).all()
        if not same or np.abs(expected - second).max() > ROUNDING_TOLERANCE_M:
            wrong.append(row)
    return check_all("C equals A after the do-operation", wrong, arrays)


def check_positions(arrays: Arrays, size_m: float) -> Iterator[Check]:
    """Check that objects of one size do not overlap, and are not below the floor.

    The check uses the spheres inside the objects: these cannot overlap, whatever the shapes and rotations.
    """
    pairs, nearest, lowest = ~np.eye(arrays["presence"].shape[-1], dtype=bool), np.inf, np.inf
    for rows, present in zip(arrays["states"][..., :3], arrays["presence"], strict=True):  # one by one to save memory
        both = present[:, :, None] & present[:, None, :] & pairs
        distance = np.linalg.norm(rows[:, :, :, None] - rows[:, :, None, :], axis=-1).min(axis=1)
        nearest = min(nearest, distance[both].min(initial=np.inf))
        lowest = min(lowest, rows[..., 2].swapaxes(1, 2)[present].min())
    apart, above = (1 - MAX_PENETRATION) * size_m, (0.5 - MAX_PENETRATION) * size_m
    yield Check("objects do not overlap, nearest centres", f"{nearest:.3f} m ≥ {apart:g} m", bool(nearest >= apart))
    yield Check("objects are above the floor, lowest centre", f"{lowest:.3f} m ≥ {above:g} m", bool(lowest >= above))


def _check_in_view(arrays: Arrays, scenario: SimulatedSearch) -> Check:
    position = arrays["states"][..., :3]
    present = np.broadcast_to(arrays["presence"][:, :, None], position.shape[:-1])
    farthest = scenario.distance_from_origin(position[present]).max()
    inside = bool(farthest <= scenario.extent + ROUNDING_TOLERANCE_M)
    return Check("objects stay in view", f"{farthest:.2f} m ≤ {scenario.extent:g} m", inside)


def _check_energy(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Check that no impact adds more than the `max_energy_gain` of the scenario, or MAX_ENERGY_GAIN."""
    largest, worst = 0.0, 0
    for row in range(len(arrays["states"])):
        scenes, trajectories = scenes_of(arrays, row, spec.scenario), trajectories_of(arrays, row)
        gain = max(map(largest_energy_gain, scenes, trajectories))
        if gain > largest:
            largest, worst = gain, int(arrays["experiment"][row])
    limit = getattr(spec.scenario, "max_energy_gain", MAX_ENERGY_GAIN)
    return Check(
        "no sequence gains energy", f"at most {largest:.2%} (experiment {worst}) ≤ {limit:.1%}", largest <= limit
    )


def scenes_of(arrays: Arrays, row: int, scenario: Scenario) -> tuple[Scene, Scene]:
    """Return the stored A and C of an experiment, with its confounders."""
    scene = build_scene(arrays, row, scenario)
    return scene, do_operation_of(arrays, row, scenario).apply(scene)


def check_twins(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Check that twins share everything except confounders, differ in both outcomes, and stay in one split and half of †."""
    differing = [name for name in SHARED_BY_TWINS if (arrays[name][::2] != arrays[name][1::2]).any()]
    first, second = arrays["states"][::2], arrays["states"][1::2]
    if (first[:, :, 0] != second[:, :, 0]).any():
        differing.append("states at t = 0")
    yield Check("twins share everything except confounders", ", ".join(differing) or "yes", not differing)
    smallest, minimum = twin_differences(arrays).min(), spec.scenario.min_difference
    passed = bool(smallest >= minimum - 1e-4)
    yield Check("smallest difference between twins, AB and CD", f"{smallest:.3f} m ≥ {minimum} m", passed)
    yield _check_index(arrays, spec)
    if spec.scenario.statics is not None:
        yield _check_held_out(arrays, spec)
    passed = np.array_equal(arrays["split"], spec.order.split[arrays["experiment"]])
    shares = " : ".join(f"{share:.2f}" for share in np.bincount(arrays["split"], minlength=3) / len(arrays["split"]))
    yield Check("train : val : test, by twin pair", shares, passed)


def _check_index(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Check that the configuration, do-operation, cell and `seen` of every experiment follow from its place."""
    seen = spec.scenario.seen_configurations(spec.num_objects, spec.data_seed)
    wrong = np.flatnonzero(arrays["seen"] != (True if seen is None else seen[arrays["configuration"]])).tolist()
    for row in range(0, len(arrays["twin"]), 2):
        place = int(arrays["experiment"][row])
        series, pair = int(spec.order.split[place]), int(spec.order.number[place])
        assignment = spec.scenario.assignment(spec.num_objects, data_seed=spec.data_seed, series=series, pair=pair)
        expected = (assignment.first, assignment.do_operation, assignment.cell)
        stored = tuple(int(arrays[name][row]) for name in ("configuration", "do_operation", "cell"))
        if stored != expected or int(arrays["configuration"][row + 1]) not in assignment.seconds:
            wrong.append(row)
    return check_all("confounders, do-operation and cell follow from the seed", wrong, arrays)


def _check_held_out(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Check that no masses and gravity occur in both halves of †, up to rotation, reflection and scale."""
    mass = np.take_along_axis(arrays["mass"], slots_in_order(arrays, spec.num_objects), axis=1).astype(float)
    gravity = arrays["gravity"][:, :2].astype(float)
    classes = canonical_problems(mass, gravity, spec.scenario.symmetries())
    seen, unseen = ({*map(tuple, classes[arrays["seen"] == half].tolist())} for half in (True, False))
    result = f"{len(seen)} and {len(unseen)}, {len(seen & unseen)} in both"
    return Check("seen and unseen (†) masses × gravity, up to symmetry and scale", result, not seen & unseen)


def check_shares(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Check that cells, do-operations and confounder values are as frequent as intended."""
    scenario, count = spec.scenario, len(arrays["twin"])
    cells = len(scenario.blocks()[0])  # cells of the pairs that share a configuration
    yield _check_shares_of_cells(arrays, scenario)
    kinds: dict[float, str] = dict(enumerate(scenario.do_operations))
    yield _check_equal_shares("do-operations", arrays["do_operation"], kinds, count // (2 * cells))
    yield from check_confounder_shares(arrays, scenario, cells)


def check_confounder_shares(arrays: Arrays, scenario: Scenario, num_cells: int) -> Iterator[Check]:
    """Check that the values of each known confounder are equally frequent.

    Args:
        num_cells: number of experiments, one per cell, that share a drawn configuration.
    """
    present = arrays["object_index"] >= 0
    confounders = {name: arrays[name][present] for name in CONFOUNDERS_OF_OBJECTS}
    confounders |= {"gravity_x": arrays["gravity"][:, 0], "gravity_y": arrays["gravity"][:, 1]}
    for name, values in confounders.items():
        if np.isnan(values).any():
            yield Check(f"share of {name}", "does not apply: unknown", True)
        else:
            labels = {value: f"{value:g}" for value in getattr(scenario.confounders, name)}
            yield _check_equal_shares(name, values, labels, len(values) // num_cells)


def _check_shares_of_cells(arrays: Arrays, scenario: Scenario) -> Check:
    """Check that each cell has the share that it has in the scenario's blocks."""
    names, blocks, count = scenario.cells(), np.concatenate(scenario.blocks()), len(arrays["cell"])
    expected = np.bincount(blocks, minlength=len(names)) / len(blocks)
    shares = np.bincount(arrays["cell"], minlength=len(names)) / count
    return _compare_shares(
        "share of cells", dict(zip(names, shares, strict=True)), expected.tolist(), [count] * len(names)
    )


def _check_equal_shares(name: str, values: np.ndarray, labels: Mapping[float, str], draws: int) -> Check:
    """Check that each value has an equal share.

    Args:
        draws: how many of the stored values were drawn independently.
    """
    shares = {label: float(np.isclose(values, value).mean()) for value, label in labels.items()}
    return _compare_shares(f"share of {name}", shares, [1 / len(shares)] * len(shares), [draws] * len(shares))


def _compare_shares(name: str, shares: Mapping[str, float], expected: Sequence[float], draws: Sequence[int]) -> Check:
    """Check that each share is near the expected one, given its number of independent draws."""
    differences = zip(shares.values(), expected, draws, strict=True)
    passed = all(abs(share - mean) <= tolerance(mean, count) for share, mean, count in differences)
    return Check(name, "  ".join(f"{label} {share:.1%}" for label, share in shares.items()), passed)


def check_cell_shapes(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Check that objects have the shapes of their cell, where cells have shapes."""
    expected = [spec.scenario.shapes_of_cell(cell) for cell in range(len(spec.scenario.cells()))]
    if expected[0] is not None:
        shapes = np.take_along_axis(arrays["shape"], slots_in_order(arrays, spec.num_objects), axis=1)
        wrong = (shapes != np.array(expected)[arrays["cell"]]).any(axis=1)
        yield check_all("shapes match the cell", np.flatnonzero(wrong).tolist(), arrays)


def check_distances(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """Check that no value of an object's confounder determines how far it travels in CD."""
    for name, distances in distances_per_value(arrays, spec).items():
        samples = list(distances.values())
        if len(samples) > 1 and min(map(len, samples)) > 0:
            largest = max(ks_2samp(*pair).statistic for pair in combinations(samples, 2))
            limit = MAX_KS_DISTANCE + 1 / np.sqrt(min(map(len, samples)))  # sampling noise of tiny datasets
            result = f"differ by {largest:.2f} ≤ {limit:.2f} (Kolmogorov-Smirnov)"
            yield Check(f"distances in CD per {name}", result, bool(largest <= limit))


def distances_per_value(arrays: Arrays, spec: Sharded) -> dict[str, dict[float, np.ndarray]]:
    """Return confounder -> value -> mean distance over time from the start in CD, of each object with that value, metres.

    Where the scenario has several cells, these distinguish the objects, and each object has its own entry. Otherwise all
    objects are pooled.
    """
    distance, presence = mean_distance(arrays)[:, 1], arrays["presence"][:, 1]
    objects = [(f" of object {k}", arrays["object_index"] == k) for k in range(spec.num_objects)]
    return {
        name + suffix: {
            value: distance[presence & mask & np.isclose(arrays[name], value)]
            for value in getattr(spec.scenario.confounders, name)
        }
        for suffix, mask in (objects if len(spec.scenario.cells()) > 1 else [("", presence)])
        for name in CONFOUNDERS_OF_OBJECTS
    }


def check_effects(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Check that D differs from B, so that copying B is not a solution, where the search guarantees it."""
    share, indirect = share_with_effect(arrays, spec), share_with_effect(arrays, spec, on_changed_object=False)
    result = f"in {share:.1%} of experiments; in {indirect:.1%} for an object that is not displaced"
    yield Check("the do-operation has an effect", result, spec.scenario.significant_effect_m is None or share == 1)


def share_with_effect(arrays: Arrays, spec: DatasetSpec, *, on_changed_object: bool = True) -> float:
    """Return the share of experiments in which the D of some remaining object differs significantly from its B.

    Args:
        on_changed_object: whether an effect on the displaced object counts.
    """
    threshold_m = spec.scenario.significant_effect_m or spec.scenario.min_difference
    position = arrays["states"][..., :3]
    distance = np.linalg.norm(position[:, 1] - position[:, 0], axis=-1).mean(axis=1)
    counts = arrays["presence"][:, 1].copy()
    if not on_changed_object:
        counts[np.arange(len(counts)), arrays["do_slot"]] = False
    farthest = np.where(counts, distance, 0.0).max(axis=1)
    return float((farthest >= threshold_m - EFFECT_ROUNDING_M).mean())


@dataclass(frozen=True)
class Geometry:
    """First frames, with objects in the scenario's order (towers: bottom to top).

    Attributes:
        position: (experiment, object, 3), metres.
        turn: (experiment, object, 2), equal where objects look equal: cos and sin of 4 × the yaw of a block, or of 2 × the
            direction of a cylinder's axis (0 where it stands); 0 for spheres.
        axis: (experiment, object, 3), see `visible_axis`.
        shape: (experiment, object).
        presence: (experiment, object).
    """

    position: np.ndarray
    turn: np.ndarray
    axis: np.ndarray
    shape: np.ndarray
    presence: np.ndarray


def geometry_of(arrays: Arrays, sequence: int, num_objects: int) -> Geometry:
    """Return the first frames of all experiments: A for sequence 0, C for sequence 1."""
    order = slots_in_order(arrays, num_objects)
    state = np.take_along_axis(arrays["states"][:, sequence, 0], order[..., None], axis=1).astype(np.float64)
    presence = np.take_along_axis(arrays["presence"][:, sequence], order, axis=1)
    shape = np.take_along_axis(arrays["shape"], order, axis=1) * presence
    axis = visible_axis(state[..., 3:7], shape)
    turn = (axis[..., 0] + 1j * axis[..., 1]) ** np.where(shape == Shape.BOX, 4, 2)
    return Geometry(state[..., :3], np.stack([turn.real, turn.imag], axis=-1), axis, shape, presence)


def check_first_frames(arrays: Arrays, num_objects: int) -> Iterator[Check]:
    """Check that no first frame, A or C, of one split looks like one of another, whatever its colours."""
    features = np.concatenate([_geometry_features(geometry_of(arrays, sequence, num_objects)) for sequence in (0, 1)])
    experiment, split = np.tile(arrays["experiment"], 2), np.tile(arrays["split"], 2)
    finite = np.isfinite(features).all(axis=1)
    features, experiment, split = features[finite], experiment[finite], split[finite]
    nearest, where = np.inf, ""
    for current in np.unique(split)[1:]:
        here, earlier = np.flatnonzero(split == current), np.flatnonzero(split < current)
        distance, index = KDTree(features[earlier]).query(features[here], p=np.inf)
        least = distance.argmin()
        if distance[least] < nearest:
            nearest = float(distance[least])
            where = f" (experiments {experiment[here[least]]} and {experiment[earlier[index[least]]]})"
    result = f"nearest {nearest:.1e} m > {SAME_SCENE_M:g} m{where}"
    yield Check("no A or C occurs in two splits", result, nearest > SAME_SCENE_M)


def _geometry_features(geometry: Geometry) -> np.ndarray:
    """Return (experiment, feature), with every coordinate sorted over objects.

    Scenes that look alike, in whatever order of objects, have similar features: sorting never increases a difference.
    """
    features = np.concatenate([geometry.position, geometry.turn, geometry.shape[..., None]], axis=-1)
    return np.sort(np.where(geometry.presence[..., None], features, ABSENT_M), axis=1).reshape(len(features), -1)


def check_towers(arrays: Arrays, spec: DatasetSpec, statics: TowerStatics) -> Iterator[Check]:
    """Check labels against the trajectories, and the stability of CD per value of each confounder (paper Fig. 3)."""
    standing = stands(arrays, statics.fallen_distance)
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    correct = _cells_of_outcomes(standing) == names
    yield Check("cells match the trajectories", f"{correct.mean():.1%}", bool(correct.all()))
    same = standing[::2] == standing[1::2]
    yield check_all("twins have opposite outcomes of CD", (2 * np.flatnonzero(same[:, 1])).tolist(), arrays)
    stand_twice = np.flatnonzero(same[:, 0] & standing[::2, 0])
    yield check_all("no A stands under both twins' confounders", (2 * stand_twice).tolist(), arrays)
    yield from _check_statics(arrays, statics, standing, spec.num_objects)
    yield from check_stability(arrays, standing[:, 1], spec.num_objects)


def _cells_of_outcomes(standing: np.ndarray) -> np.ndarray:
    """Return the names of the cells, (experiment,), that follow from the outcomes of AB and CD."""
    words = np.where(standing, "stands", "falls")
    both_fall = np.repeat(~standing[::2, 0] & ~standing[1::2, 0], 2)
    return np.char.add(np.char.add(np.where(both_fall, "both_fall", words[:, 0]), "_"), words[:, 1])


def _check_statics(arrays: Arrays, statics: TowerStatics, standing: np.ndarray, num_objects: int) -> Iterator[Check]:
    """Check that statics of the stored geometry give the stored outcomes, and that AB determines those of CD."""
    combinations, slots = statics.combinations(num_objects), slots_in_order(arrays, num_objects)
    mass = np.take_along_axis(arrays["mass"], slots, axis=1)
    true = combinations.nearest(Combinations(mass, arrays["gravity"][:, :2] / -statics.gravity_z))[:, None]
    (falls_from, observed_stands), (_, counterfactual_stands) = (
        _statics_of_first_frames(arrays, statics, sequence, num_objects) for sequence in (0, 1)
    )
    expected = [np.take_along_axis(each, true, axis=1) for each in (observed_stands, counterfactual_stands)]
    share = np.mean(np.concatenate(expected, axis=1) == standing)
    yield Check("statics agree with the stored outcomes", f"{share:.1%}", bool(share == 1))
    share = np.take_along_axis(is_identifiable(falls_from, counterfactual_stands, combinations), true, axis=1).mean()
    yield Check("by statics, AB determines whether CD stands", f"{share:.1%}", bool(share >= MIN_SETTLED))
    # such a block shows its mass in AB, so it has to move
    must_fall = np.arange(num_objects) >= np.take_along_axis(falls_from, true, axis=1)
    stays = np.take_along_axis(in_place(arrays, statics.fallen_distance)[:, 0], slots, axis=1)
    share = (must_fall <= ~stays).all(axis=1).mean()
    yield Check("blocks of A that must fall by statics fall", f"{share:.1%}", bool(share >= MIN_SETTLED))


def _statics_of_first_frames(
    arrays: Arrays, statics: TowerStatics, sequence: int, num_objects: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the level from which towers fall, and whether they stand, both (experiment, combination), by statics."""
    combinations, tower = statics.combinations(num_objects), geometry_of(arrays, sequence, num_objects)
    xy, yaw = tower.position[..., :2], np.arctan2(tower.axis[..., 1], tower.axis[..., 0])
    levels = tower.presence.sum(axis=1)
    falls_from = np.zeros((len(xy), len(combinations.mass)), dtype=np.int64)
    for count in np.unique(levels).tolist():
        rows = levels == count
        falls_from[rows] = statics.falls_from(xy[rows, :count], yaw[rows, :count], combinations)
    return falls_from, falls_from == levels[:, None]


def check_stability(arrays: Arrays, standing: np.ndarray, num_objects: int) -> Iterator[Check]:
    """Check that half of the towers of CD stand, for each value of each known confounder (paper Fig. 3).

    Args:
        standing: (experiment,) whether the tower of CD stands.
    """
    confounders = {name: arrays["gravity"][:, axis] for axis, name in enumerate(("gravity_x", "gravity_y"))}
    for level in range(num_objects):
        slot = arrays["object_index"] == level
        confounders |= {f"{name} of block {level}": arrays[name][slot] for name in ("mass", "friction")}
    for name, values in confounders.items():
        if not np.isnan(values).any():
            kinds, counts = np.unique(values, return_counts=True)
            shares = {f"{value:g}:": float(standing[values == value].mean()) for value in kinds}
            yield _compare_shares(f"share of CD that stand, per {name}", shares, [0.5] * len(kinds), counts.tolist())
