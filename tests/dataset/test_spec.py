"""The id of a dataset depends on everything that its bytes depend on."""

from copy import deepcopy
from dataclasses import replace

from tests.dataset.copies import SPEC


def test_a_changed_constant_is_another_dataset() -> None:
    assert deepcopy(SPEC).id == SPEC.id
    changed = deepcopy(SPEC)
    changed.scenario.min_difference += 0.01
    assert changed.id != SPEC.id
    changed = deepcopy(SPEC)
    changed.scenario.task.stable_speed += 0.01  # only for the evaluation
    assert changed.id == SPEC.id


def test_another_seed_or_number_of_experiments_is_another_dataset() -> None:
    size = replace(SPEC.size, num_experiments={"collision": {"2": SPEC.num_experiments + 2}})
    others = [replace(SPEC, data_seed=1), replace(SPEC, size=size)]
    assert len({SPEC.id, *(spec.id for spec in others)}) == 3
