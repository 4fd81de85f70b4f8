"""What C, the do-operation or the observed outcome alone tell of D.

Twins share C and the do-operation, and their CD have opposite outcomes. So whatever is answered from those alone is right
for exactly one of the two: in a sound dataset such a line says 50 % without any spread. It says something else as soon as
twins are not twins.
"""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.bias import visible_features
from cophy.dataset.audit.bias.classifiers import NUM_FOLDS, ask_classifier
from cophy.dataset.audit.checks import Arrays, Check
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.state_features import further_than_twin, in_place, objects_distance, stands


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
    scene, twin = visible_features.initial_scene(arrays, spec.num_objects), arrays["twin"]
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
    scene, twin = visible_features.initial_scene(arrays, spec.num_objects), arrays["twin"]
    further, moved = further_than_twin(arrays), objects_distance(arrays)[:, 1]
    yield ask_classifier("C tells whether CD goes further than the twin's", scene, further[:, 1], twin)
    long, name = moved > np.median(moved), "C tells whether CD goes further than in half of all experiments"
    yield ask_classifier(name, scene, long, twin, expected="places and ways free do matter")
    name = "the observed outcome tells whether CD goes further than the twin's"
    yield ask_classifier(name, further[:, :1], further[:, 1], twin, expected="what is heavy in AB is heavy in CD")
    for name, features in _shared_by_twins(arrays):
        yield ask_classifier(f"{name} whether CD goes further than the twin's", features, further[:, 1], twin)


def _shared_by_twins(arrays: Arrays) -> Iterator[tuple[str, np.ndarray]]:
    yield "the number of objects tells", visible_features.number_of_objects(arrays)
    yield "the do-operation's kind and size tell", visible_features.do_operation(arrays)
    yield "colours tell", visible_features.colours(arrays)
