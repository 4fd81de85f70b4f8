"""What can be known of D without the motion of AB? Classifiers that never see it are asked (paper Sec. 3, Table 6 right).

Each experiment is judged once, by a classifier fitted without it and without its twin. Twins share C and the do-operation,
and their CD have opposite outcomes, so that whatever is answered from those alone is right for exactly one of the two: in a
sound dataset such a line says 50 % without any spread. It says something else as soon as twins are not twins.
"""

from collections.abc import Iterator

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from cophy.dataset.audit import clues
from cophy.dataset.audit.check import Arrays, Check, ProbeCheck
from cophy.dataset.audit.outcomes import further_than_twin, in_place, objects_distance, stands
from cophy.dataset.spec import DatasetSpec
from cophy.intervals import interval
from cophy.scenario import Blocktower

FOLDS = 5
BIAS = (
    0.02  # ours: above chance. The paper's data allow 0.8 % more than "all blocks stay" (Table 6 right: 71.8, 71.0 %)
)
ENOUGH = 2000  # experiments from which on BIAS is asked for; below, three standard deviations where that is more


def bias(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Probes: C and the do-operation together, then each shortcut alone."""
    pairs = len(np.unique(arrays["twin"]))
    if pairs < FOLDS:
        yield Check("what C tells of D", f"not asked: {pairs} twin pairs are fewer than {FOLDS}", True)
    elif isinstance(spec.scenario, Blocktower):
        yield from _of_towers(arrays, spec, spec.scenario.fallen_distance)
    else:
        yield from _of_paths(arrays, spec)


def _of_towers(arrays: Arrays, spec: DatasetSpec, fallen_distance: float) -> Iterator[Check]:
    scene, twin = clues.initial_scene(arrays, spec.num_objects), arrays["twin"]
    stays, standing = in_place(arrays, fallen_distance)[:, 1], stands(arrays, fallen_distance)
    yield probe("C tells whether CD stands", scene, standing[:, 1], twin)
    for level in range(spec.num_objects):
        block = (arrays["object_index"] == level) & arrays["presence"][:, 1]
        rows = block.any(axis=1)
        if len(np.unique(twin[rows])) >= FOLDS:
            outcome = (stays & block).any(axis=1)[rows]
            base_rate = float(max(outcome.mean(), 1 - outcome.mean()))
            yield probe(f"C tells whether block {level} stays", scene[rows], outcome, twin[rows], chance=base_rate)
    yield probe("the observed outcome tells whether CD stands", standing[:, :1], standing[:, 1], twin)
    for name, features in _shared_by_twins(arrays):
        yield probe(f"{name} whether CD stands", features, standing[:, 1], twin)


def _of_paths(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    scene, twin = clues.initial_scene(arrays, spec.num_objects), arrays["twin"]
    further, moved = further_than_twin(arrays), objects_distance(arrays)[:, 1]
    yield probe("C tells whether CD goes further than the twin's", scene, further[:, 1], twin)
    long, name = moved > np.median(moved), "C tells whether CD goes further than in half of all experiments"
    yield probe(name, scene, long, twin, expected="places and ways free do matter")
    name = "the observed outcome tells whether CD goes further than the twin's"
    yield probe(name, further[:, :1], further[:, 1], twin, expected="what is heavy in AB is heavy in CD")
    for name, features in _shared_by_twins(arrays):
        yield probe(f"{name} whether CD goes further than the twin's", features, further[:, 1], twin)


def _shared_by_twins(arrays: Arrays) -> Iterator[tuple[str, np.ndarray]]:
    yield "the number of objects tells", clues.number_of_objects(arrays)
    yield "the do-operation's kind and size tell", clues.do_operation(arrays)
    yield "colours tell", clues.colours(arrays)


def probe(
    name: str, features: np.ndarray, outcome: np.ndarray, twin: np.ndarray, *, chance: float = 0.5, expected: str = ""
) -> ProbeCheck:
    """How often a classifier guesses a binary outcome (experiment,) from features (experiment, feature).

    chance: the share right without looking. expected: why more than that is no fault but a fact, to be reported.
    """
    right = (foretold(features, outcome, twin) == outcome).astype(float)
    accuracy, (low, high) = float(right.mean()), interval(right, twin)
    margin = BIAS if len(right) >= ENOUGH else max(BIAS, 3 * 0.5 / float(np.sqrt(len(np.unique(twin)))))
    found = f"{accuracy:.1%} [{low:.1%}, {high:.1%}] of {len(right)}, by chance {chance:.1%}, "
    found += f"no limit: {expected}" if expected else f"at most {chance + margin:.1%}"
    return ProbeCheck(name, found, bool(expected) or accuracy <= chance + margin, accuracy, low, high, chance)


def foretold(features: np.ndarray, outcome: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """(experiment,) bool, what boosted trees make of the features, cross-validated over twin pairs.

    They regress on 0 and 1, which allows a fold without one of them. One thread: several wait for each other on trees this small, and
    beside other work that takes many times as long.
    """
    found = np.zeros(len(outcome), dtype=bool)
    with threadpool_limits(1):
        for fitted, tested in GroupKFold(FOLDS).split(features, groups=twin):
            trees = HistGradientBoostingRegressor(
                learning_rate=0.05, max_leaf_nodes=8, early_stopping=False, random_state=0
            )
            found[tested] = trees.fit(features[fitted], outcome[fitted]).predict(features[tested]) > 0.5
    return found
