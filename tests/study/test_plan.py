"""The plan is balanced, keeps twins apart, and is the same at every call."""

from collections import Counter

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.study.plan import SETTINGS, StudySettings, StudyTask, plan_tasks, practice_tasks, select_pairs

KINDS = np.random.default_rng(7).integers(0, 4, size=(90, 2))
CASES = [(40, 20, 0), (60, 20, 1), (12, 3, 2), (2, 1, 3)]


def settings_of(num_pairs: int, num_assignments: int, seed: int) -> StudySettings:
    return StudySettings(seed, num_pairs, num_assignments, seconds=10, tolerance_s=3, resolution=448)


def plans(case: tuple[int, int, int]) -> tuple[StudySettings, np.ndarray, list[list[StudyTask]]]:
    """Return the selected pairs and the tasks of the participants of two full turns."""
    settings = settings_of(*case)
    pairs = select_pairs(np.arange(90) * 3, KINDS, settings)
    turn = 2 * settings.num_pairs // settings.num_assignments
    return settings, pairs, [plan_tasks(number, pairs, KINDS[pairs // 3], settings) for number in range(2 * turn)]


@pytest.mark.parametrize("case", CASES)
def test_every_participant_has_as_many_tasks_of_each_setting_and_no_pair_twice(case: tuple[int, int, int]) -> None:
    settings, pairs, plan = plans(case)
    for tasks in plan:
        assert Counter(task.setting for task in tasks) == dict.fromkeys(SETTINGS, settings.num_assignments)
        seen = {task.experiment // 2 for task in tasks}
        assert len(seen) == len(tasks)
        assert seen <= set(pairs.tolist())


@pytest.mark.parametrize("case", CASES)
def test_a_full_turn_shows_every_experiment_once_in_every_setting(case: tuple[int, int, int]) -> None:
    _, pairs, plan = plans(case)
    experiments = [experiment for pair in pairs.tolist() for experiment in (2 * pair, 2 * pair + 1)]
    for turn in (plan[: len(plan) // 2], plan[len(plan) // 2 :]):
        counts = Counter(task for tasks in turn for task in tasks)
        assert counts == {StudyTask(experiment, setting): 1 for experiment in experiments for setting in SETTINGS}


def test_every_participant_sees_every_kind_of_pair_evenly() -> None:
    _, pairs, plan = plans((40, 20, 0))
    kinds = [tuple(kind) for kind in KINDS[pairs // 3].tolist()]
    kind_of = dict(zip(pairs.tolist(), kinds, strict=True))
    for tasks in plan:
        for setting in SETTINGS:
            counts = Counter(kind_of[task.experiment // 2] for task in tasks if task.setting == setting)
            assert all(abs(counts[kind] - kinds.count(kind) / 2) < 1 for kind in set(kinds))


def test_orders_differ_between_participants_and_seeds_and_not_between_calls() -> None:
    _, _, plan = plans((40, 20, 0))
    assert plans((40, 20, 0))[2] == plan
    assert plans((40, 20, 5))[2] != plan
    assert len({tuple(tasks) for tasks in plan}) == len(plan)
    assert {tasks[0].setting for tasks in plan} == set(SETTINGS)


def test_practice_has_each_setting_once() -> None:
    tasks = practice_tasks(np.array([4, 9, 11]), settings_of(2, 1, 0))
    assert [task.setting for task in tasks] == list(SETTINGS)
    assert {task.experiment // 2 for task in tasks} <= {4, 9, 11}


def test_too_few_pairs_and_odd_numbers_are_refused() -> None:
    with pytest.raises(CophyError, match="larger size"):
        select_pairs(np.arange(3), KINDS[:3], settings_of(4, 2, 0))
    with pytest.raises(ValueError, match="multiple"):
        settings_of(30, 20, 0)
