"""Twins share all but confounders, differ in both outcomes, and stay on one side of the split, and of †.

Cells, do-operations and confounder values are level (paper Sec. 3: balanced and bias free).
D is another than B: what the do-operation changed has to be foreseen, copying B is wrong.
What a first frame shows: where objects are, how they are turned, and which shape they have, whatever their colours.
States are those of rigid bodies in this scene: finite, apart, in sight, without energy from nowhere.
What only towers have: labels, and outcomes balanced for every value of every confounder (paper Sec. 3, Fig. 3).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import ks_2samp

from cophy.audit.checks import Arrays, Check, none_wrong, tolerance
from cophy.dataset.difficulty import twin_differences
from cophy.dataset.features import in_place, mean_distance, stands, visible_axis
from cophy.dataset.fields import CONFOUNDERS_OF_OBJECTS
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.shards import Sharded
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import split_of_experiments
from cophy.scenario import Scenario, Shape
from cophy.scenario.assignment import problems
from cophy.scenario.physics import largest_gain
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.statics import Combinations, TowerStatics
from cophy.scenario.towers import settled

# ours: Kolmogorov-Smirnov. What is heavy goes less far (0.55 for what is hit in collisions), but no value settles how far
MAX_APART = 0.65


def shares(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Frequencies of cells, do-operations and confounder values: as intended, up to chance and BALANCE_TOLERANCE."""
    scenario, count, grid = spec.scenario, len(arrays["twin"]), spec.scenario.confounders
    cells = len(scenario.blocks()[0])  # of the pairs that share a configuration
    yield _as_the_blocks(arrays, spec.scenario)
    kinds = dict(enumerate(scenario.do_operations))
    yield level("do-operations", arrays["do_operation"], kinds, draws=count // (2 * cells))
    present = arrays["object_index"] >= 0
    # each configuration that is drawn serves one experiment per cell
    for name in ("mass", "friction", "restitution"):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays[name][present], values, draws=present.sum() // cells)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays["gravity"][:, axis], values, draws=count // cells)


def shapes(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Where a cell names the shapes of objects, they have these."""
    named = [spec.scenario.shapes_of_cell(cell) for cell in range(len(spec.scenario.cells()))]
    if named[0] is not None:
        slots = slots_in_order(arrays, spec.num_objects)
        found = np.take_along_axis(arrays["shape"], slots, axis=1)
        wrong = (found != np.array(named)[arrays["cell"]]).any(axis=1)
        yield none_wrong("shapes are those of the cell", np.flatnonzero(wrong).tolist())


def _as_the_blocks(arrays: Arrays, scenario: Scenario) -> Check:
    """Whether each cell has the share that it has in the scenario's blocks."""
    names, blocks = scenario.cells(), np.concatenate(scenario.blocks())
    expected = np.bincount(blocks, minlength=len(names)) / len(blocks)
    found = np.bincount(arrays["cell"], minlength=len(names)) / len(arrays["cell"])
    allowed = [tolerance(share, len(arrays["cell"])) for share in expected]
    text = "  ".join(f"{name} {share:.1%}" for name, share in zip(names, found, strict=True))
    return Check("share of cells", text, bool((np.abs(found - expected) <= allowed).all()))


def level(name: str, values: np.ndarray, labels: Mapping[int, str] | Mapping[float, str], *, draws: int) -> Check:
    """Whether each value has an equal share.

    Args:
        name: what is shared.
        values: found, any shape.
        labels: of the values that there are.
        draws: how many of the values were drawn independently.
    """
    share = {label: float(np.isclose(values, value).mean()) for value, label in labels.items()}
    equal = 1 / len(share)
    passed = all(abs(value - equal) <= tolerance(equal, draws) for value in share.values())
    return Check(f"share of {name}", "  ".join(f"{label} {value:.1%}" for label, value in share.items()), passed)


def trajectories(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """How far apart the distributions of paths in CD are under two values of an object's own confounder."""
    for name, paths in paths_per_value(arrays, spec).items():
        samples = list(paths.values())
        if len(samples) > 1 and min(map(len, samples)) > 0:
            apart = max(ks_2samp(samples[0], other).statistic for other in samples[1:])
            limit = MAX_APART + 1 / np.sqrt(min(map(len, samples)))  # chance adds to it in tiny sets
            found = f"apart by {apart:.2f} ≤ {limit:.2f} (Kolmogorov-Smirnov)"
            yield Check(f"paths in CD per {name}", found, bool(apart <= limit))


def paths_per_value(arrays: Arrays, spec: Sharded) -> dict[str, dict[float, np.ndarray]]:
    """Confounder -> value -> how far objects with that value are from their start in CD, averaged over time, metres.

    Per object where the scenario has several cells, because these tell its objects apart (in the scenario's own order).
    Otherwise over all objects.
    """
    moved, presence = mean_distance(arrays)[:, 1], arrays["presence"][:, 1]
    places = [(f" of object {k}", arrays["object_index"] == k) for k in range(spec.num_objects)]
    return {
        name + place: {
            value: moved[presence & chosen & np.isclose(arrays[name], value)]
            for value in getattr(spec.scenario.confounders, name)
        }
        for place, chosen in (places if len(spec.scenario.cells()) > 1 else [("", presence)])
        for name in ("mass", "friction", "restitution")
    }


OUTCOME_TOLERANCE_M = 1e-4  # stored states are rounded


def do_operations_matter(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """In how many experiments the do-operation matters; in all where the search promises it (see `significant_effect_m`)."""
    share, apart = matters(arrays, spec), matters(arrays, spec, acted_on=False)
    found = f"in {share:.1%} of experiments; in {apart:.1%} to an object that it does not act on"
    yield Check("the do-operation matters", found, spec.scenario.significant_effect_m is None or share == 1)


def matters(arrays: Arrays, spec: DatasetSpec, *, acted_on: bool = True) -> float:
    """Share of experiments in which the D of some object that remains differs significantly from its B.

    Args:
        arrays: of the dataset.
        spec: of the dataset.
        acted_on: whether the object that the do-operation displaces counts.
    """
    threshold_m = spec.scenario.significant_effect_m or spec.scenario.min_difference
    position = arrays["states"][..., :3]
    distance = np.linalg.norm(position[:, 1] - position[:, 0], axis=-1).mean(axis=1)
    counts = arrays["presence"][:, 1].copy()
    if not acted_on:
        counts[np.arange(len(counts)), arrays["do_slot"]] = False
    furthest = np.where(counts, distance, 0.0).max(axis=1)
    return float((furthest >= threshold_m - OUTCOME_TOLERANCE_M).mean())


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


ROUNDING_TOLERANCE_M = 1e-5  # of float32
MAX_PENETRATION = 0.05  # penetration as a share of an object's size: what Bullet needs to turn the fastest balls around (docs/benchmark/physics.md)
MAX_ENERGY_GAIN = 0.01  # of energy between two states, as conf/scenario/balls.yaml has it


def states(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """All checks on trajectories."""
    finite = bool(np.isfinite(arrays["states"]).all())
    vacant = arrays["object_index"] < 0
    given = [
        arrays["states"].swapaxes(2, 3)[~arrays["presence"]],
        *(arrays[name][vacant] for name in CONFOUNDERS_OF_OBJECTS),
    ]
    empty = not any(values.any() for values in given)
    yield Check("states are finite, empty slots zero", "yes" if finite and empty else "no", finite and empty)
    yield _configurations(arrays, spec)
    if finite:
        yield _do_operations(arrays)
        yield from places(arrays, spec.scenario.object_size_m)
        if isinstance(spec.scenario, SimulatedSearch):
            yield _in_sight(arrays, spec.scenario)
        yield _energy(arrays, spec)


def _configurations(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Masses, frictions, restitutions and gravity are those of the configuration, in the scenario's order."""
    wrong, slots = [], slots_in_order(arrays, spec.num_objects)
    for row, configuration in enumerate(arrays["configuration"].tolist()):
        truth = spec.scenario.confounders.decode(configuration, spec.num_objects)
        stored = [arrays[name][row, slots[row]] for name in CONFOUNDERS_OF_OBJECTS]
        expected = [truth.mass, truth.friction, truth.restitution]
        gravity = (*truth.gravity_xy, spec.scenario.gravity_z)
        if not np.allclose(stored, expected) or not np.allclose(arrays["gravity"][row], gravity):
            wrong.append(row)
    return none_wrong("confounders are those of the configuration", wrong)


def _do_operations(arrays: Arrays) -> Check:
    """At t = 0, C differs from A by the do-operation and by nothing else."""
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
    return none_wrong("C is A under the do-operation", wrong)


def places(arrays: Arrays, size_m: float) -> Iterator[Check]:
    """Objects of one size do not overlap, and are not below the floor.

    Spheres that fit into two objects cannot overlap, whatever the objects' shapes and turns.
    """
    others, nearest, lowest = ~np.eye(arrays["presence"].shape[-1], dtype=bool), np.inf, np.inf
    for rows, present in zip(arrays["states"][..., :3], arrays["presence"], strict=True):  # pairs of all take memory
        both = present[:, :, None] & present[:, None, :] & others
        distance = np.linalg.norm(rows[:, :, :, None] - rows[:, :, None, :], axis=-1).min(axis=1)
        nearest = min(nearest, distance[both].min(initial=np.inf))
        lowest = min(lowest, rows[..., 2].swapaxes(1, 2)[present].min())
    apart, above = (1 - MAX_PENETRATION) * size_m, (0.5 - MAX_PENETRATION) * size_m
    yield Check("objects are apart, centres at least", f"{nearest:.3f} m ≥ {apart:g} m", bool(nearest >= apart))
    yield Check("objects are above the floor, centres at least", f"{lowest:.3f} m ≥ {above:g} m", bool(lowest >= above))


def _in_sight(arrays: Arrays, scenario: SimulatedSearch) -> Check:
    position = arrays["states"][..., :3]
    seen = np.broadcast_to(arrays["presence"][:, :, None], position.shape[:-1])
    furthest = scenario.distance_in_sight(position[seen]).max()
    inside = bool(furthest <= scenario.extent + ROUNDING_TOLERANCE_M)
    return Check("objects stay in sight", f"{furthest:.2f} m ≤ {scenario.extent:g} m", inside)


def _energy(arrays: Arrays, spec: DatasetSpec) -> Check:
    """No impact adds more than MAX_ENERGY_GAIN."""
    most, where = 0.0, 0
    for row in range(len(arrays["states"])):
        scene = scene_of(arrays, row, spec.scenario)
        scenes = (scene, do_operation_of(arrays, row, spec.scenario).apply(scene))
        gain = max(largest_gain(s, t) for s, t in zip(scenes, trajectories_of(arrays, row), strict=True))
        if gain > most:
            most, where = gain, row
    return Check("no sequence gains energy", f"at most {most:.2%} (experiment {where})", most <= MAX_ENERGY_GAIN)


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


SHARED_BY_TWINS = (
    "twin",
    "split",
    "shape",
    "object_index",
    "presence",
    "do_operation",
    "do_slot",
    "do_offset",
    "background_seed",
)


def twins(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """All checks on pairs of twins."""
    differing = [name for name in SHARED_BY_TWINS if (arrays[name][::2] != arrays[name][1::2]).any()]
    first, second = arrays["states"][::2], arrays["states"][1::2]
    if (first[:, :, 0] != second[:, :, 0]).any():
        differing.append("states at t = 0")
    yield Check("twins share all but confounders", ", ".join(differing) or "yes", not differing)
    smallest = twin_differences(arrays).min()
    needed = spec.scenario.min_difference
    yield Check(
        "smallest difference of twins, AB and CD", f"{smallest:.3f} m ≥ {needed} m", bool(smallest >= needed - 1e-4)
    )
    yield _prescribed(arrays, spec)
    if spec.scenario.statics is not None:
        yield _held_out(arrays, spec)
    in_place = np.array_equal(arrays["split"], split_of_experiments(spec.num_experiments, spec.data_seed))
    shares = " : ".join(f"{share:.2f}" for share in np.bincount(arrays["split"], minlength=3) / len(arrays["split"]))
    yield Check("train : val : test, by twin pair", shares, in_place)


def _prescribed(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Every experiment has the configuration, do-operation and cell that its index stands for, which keeps them level; `seen` too."""
    seen = spec.scenario.seen_configurations(spec.num_objects, spec.data_seed)
    wrong = np.flatnonzero(arrays["seen"] != (True if seen is None else seen[arrays["configuration"]])).tolist()
    for row in range(0, len(arrays["twin"]), 2):
        assignment = spec.scenario.assignment(spec.num_objects, data_seed=spec.data_seed, pair=int(arrays["twin"][row]))
        expected = (assignment.first, assignment.do_operation, assignment.cell)
        found = tuple(int(arrays[name][row]) for name in ("configuration", "do_operation", "cell"))
        if found != expected or int(arrays["configuration"][row + 1]) not in assignment.seconds:
            wrong.append(row)
    return none_wrong("confounders and do-operation are those of the index", wrong)


def _held_out(arrays: Arrays, spec: DatasetSpec) -> Check:
    """No masses and gravity of the half that † splits train on are in the other half: not turned, mirrored or scaled either."""
    mass = np.take_along_axis(arrays["mass"], slots_in_order(arrays, spec.num_objects), axis=1).astype(float)
    gravity = arrays["gravity"][:, :2].astype(float)
    found = problems(mass, gravity, spec.scenario.symmetries())
    seen, unseen = ({*map(tuple, found[arrays["seen"] == half].tolist())} for half in (True, False))
    numbers = f"{len(seen)} and {len(unseen)}, {len(seen & unseen)} in both"
    return Check("masses × gravity seen and unseen (†), up to symmetry and scale", numbers, not seen & unseen)
