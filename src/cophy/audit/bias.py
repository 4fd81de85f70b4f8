"""What C, the do-operation or the observed outcome alone tell of D.

Classifiers that are asked for an outcome they should not know.

Each experiment is judged once, by a classifier fitted without it and without its twin.
What there is to be seen before anything moves, as features of a classifier.
"""

from collections.abc import Iterator

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from cophy.audit.checks import Arrays, Check, ClassifierCheck
from cophy.audit.data import geometry_of
from cophy.bootstrap import interval
from cophy.dataset.features import further_than_twin, in_place, objects_distance, stands
from cophy.dataset.spec import DatasetSpec

NUM_FOLDS = 5
# above chance; ours. The paper's data allow 0.8 % more than "all blocks stay" (Table 6 right: 71.8, 71.0 %)
MAX_BIAS = 0.02
MIN_EXPERIMENTS = 2000  # from which on MAX_BIAS is asked for; below, three standard deviations where that is more


def ask_classifier(
    name: str, features: np.ndarray, outcome: np.ndarray, twin: np.ndarray, *, chance: float = 0.5, expected: str = ""
) -> ClassifierCheck:
    """How often a classifier guesses a binary outcome.

    Args:
        name: the question, as the line of the audit says it.
        features: (experiment, feature) what it sees.
        outcome: (experiment,) bool, what it is asked for.
        twin: (experiment,) twin pair.
        chance: the share that is right without looking.
        expected: why more than that is no fault but a fact; it is reported then.
    """
    right = (foretold(features, outcome, twin) == outcome).astype(float)
    accuracy, (low, high) = float(right.mean()), interval(right, twin)
    margin = MAX_BIAS
    if len(right) < MIN_EXPERIMENTS:
        margin = max(MAX_BIAS, 3 * 0.5 / float(np.sqrt(len(np.unique(twin)))))
    found = f"{accuracy:.1%} [{low:.1%}, {high:.1%}] of {len(right)}, by chance {chance:.1%}, "
    found += f"no limit: {expected}" if expected else f"at most {chance + margin:.1%}"
    return ClassifierCheck(name, found, bool(expected) or accuracy <= chance + margin, accuracy, low, high, chance)


def foretold(features: np.ndarray, outcome: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """What boosted trees predict from the features, cross-validated over twin pairs.

    The trees regress on 0 and 1, so that a fold may lack one of the two outcomes. They use one thread. On trees this
    small, several threads wait for each other; beside other work they take many times as long.

    Args:
        features: (experiment, feature).
        outcome: (experiment,) bool.
        twin: (experiment,) twin pair.

    Returns:
        (experiment,) bool.
    """
    found = np.zeros(len(outcome), dtype=bool)
    with threadpool_limits(1):
        for fitted, tested in GroupKFold(NUM_FOLDS).split(features, groups=twin):
            trees = HistGradientBoostingRegressor(
                learning_rate=0.05, max_leaf_nodes=8, early_stopping=False, random_state=0
            )
            found[tested] = trees.fit(features[fitted], outcome[fitted]).predict(features[tested]) > 0.5
    return found


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


def bias(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """First C and the do-operation together, then each shortcut alone."""
    pairs, statics = len(np.unique(arrays["twin"])), spec.scenario.statics
    if pairs < NUM_FOLDS:
        yield Check("what C tells of D", f"not asked: {pairs} twin pairs are fewer than {NUM_FOLDS}", True)
    elif statics is not None:
        yield from _of_towers(arrays, spec, statics.fallen_distance)
    else:
        yield from _of_paths(arrays, spec)


def _of_towers(arrays: Arrays, spec: DatasetSpec, fallen_distance: float) -> Iterator[Check]:
    scene, twin = initial_scene(arrays, spec.num_objects), arrays["twin"]
    stays, standing = in_place(arrays, fallen_distance)[:, 1], stands(arrays, fallen_distance)
    yield ask_classifier("C tells whether CD stands", scene, standing[:, 1], twin)
    for level in range(spec.num_objects):
        block = (arrays["object_index"] == level) & arrays["presence"][:, 1]
        rows = block.any(axis=1)
        if len(np.unique(twin[rows])) >= NUM_FOLDS:
            outcome = (stays & block).any(axis=1)[rows]
            base_rate = float(max(outcome.mean(), 1 - outcome.mean()))
            name = f"C tells whether block {level} stays"
            yield ask_classifier(name, scene[rows], outcome, twin[rows], chance=base_rate)
    yield ask_classifier("the observed outcome tells whether CD stands", standing[:, :1], standing[:, 1], twin)
    for name, features in _shared_by_twins(arrays):
        yield ask_classifier(f"{name} whether CD stands", features, standing[:, 1], twin)


def _of_paths(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    scene, twin = initial_scene(arrays, spec.num_objects), arrays["twin"]
    further, moved = further_than_twin(arrays), objects_distance(arrays)[:, 1]
    yield ask_classifier("C tells whether CD goes further than the twin's", scene, further[:, 1], twin)
    long, name = moved > np.median(moved), "C tells whether CD goes further than in half of all experiments"
    yield ask_classifier(name, scene, long, twin, expected="places and ways free do matter")
    name = "the observed outcome tells whether CD goes further than the twin's"
    yield ask_classifier(name, further[:, :1], further[:, 1], twin, expected="what is heavy in AB is heavy in CD")
    for name, features in _shared_by_twins(arrays):
        yield ask_classifier(f"{name} whether CD goes further than the twin's", features, further[:, 1], twin)


def _shared_by_twins(arrays: Arrays) -> Iterator[tuple[str, np.ndarray]]:
    yield "the number of objects tells", number_of_objects(arrays)
    yield "the do-operation's kind and size tell", do_operation(arrays)
    yield "colours tell", colours(arrays)
