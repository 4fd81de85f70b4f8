"""Whatever bytes depend on is in the name of a dataset."""

from tests.conftest import tiny_spec
from tests.dataset.copies import SPEC


def test_a_changed_constant_is_another_dataset() -> None:
    assert tiny_spec("collision").id == SPEC.id
    changed = tiny_spec("collision")
    changed.scenario.min_difference += 0.01
    assert changed.id != SPEC.id
    judged_otherwise = tiny_spec("collision")
    judged_otherwise.scenario.task.stable_speed += 0.01
    assert judged_otherwise.id == SPEC.id
