"""The id of a dataset depends on everything that its bytes depend on."""

from copy import deepcopy

from tests.dataset.copies import SPEC


def test_a_changed_constant_is_another_dataset() -> None:
    assert deepcopy(SPEC).id == SPEC.id
    changed = deepcopy(SPEC)
    changed.scenario.min_difference += 0.01
    assert changed.id != SPEC.id
    changed = deepcopy(SPEC)
    changed.scenario.task.stable_speed += 0.01  # only for the evaluation
    assert changed.id == SPEC.id
