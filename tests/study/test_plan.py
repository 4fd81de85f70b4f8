"""The plan is balanced, keeps twins apart, and is the same at every call."""

from collections import Counter

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.study.sessions import Assignment, assignments_of, chosen_pairs, practice
from cophy.study.settings import SETTINGS, StudySettings

KINDS = np.random.default_rng(7).integers(0, 4, size=(90, 2))
CASES = [(40, 20, 0), (40, 20, 5), (60, 20, 1), (12, 3, 2), (2, 1, 3)]


def settings_of(num_pairs: int, num_assignments: int, seed: int) -> StudySettings:
    return StudySettings(seed, num_pairs, num_assignments, seconds=10, tolerance_s=3, resolution=448)


def plans(case: tuple[int, int, int]) -> tuple[StudySettings, np.ndarray, list[list[Assignment]]]:
    """For two full turns of participants."""
    settings = settings_of(*case)
    pairs = chosen_pairs(np.arange(90) * 3, KINDS, settings)
    kinds = KINDS[pairs // 3]
    turn = 2 * settings.num_pairs // settings.num_assignments
    return settings, pairs, [assignments_of(number, pairs, kinds, settings) for number in range(2 * turn)]


@pytest.mark.parametrize("case", CASES)
def test_everyone_has_as_many_of_each_setting_and_no_pair_twice(case: tuple[int, int, int]) -> None:
    settings, pairs, plan = plans(case)
    for mine in plan:
        assert Counter(each.setting for each in mine) == dict.fromkeys(SETTINGS, settings.num_assignments)
        seen = [each.experiment // 2 for each in mine]
        assert len(set(seen)) == len(seen)
        assert set(seen) <= set(pairs.tolist())


@pytest.mark.parametrize("case", CASES)
def test_a_full_turn_shows_every_experiment_once_in_every_setting(case: tuple[int, int, int]) -> None:
    _settings, pairs, plan = plans(case)
    experiments = [experiment for pair in pairs.tolist() for experiment in (2 * pair, 2 * pair + 1)]
    for turn in (plan[: len(plan) // 2], plan[len(plan) // 2 :]):
        counts = Counter(each for mine in turn for each in mine)
        assert counts == {Assignment(each, setting): 1 for each in experiments for setting in SETTINGS}


def test_everyone_has_every_kind_of_pair_evenly() -> None:
    _settings, pairs, plan = plans((40, 20, 0))
    kinds = [tuple(kind) for kind in KINDS[pairs // 3].tolist()]
    kind_of = dict(zip(pairs.tolist(), kinds, strict=True))
    for mine in plan:
        for setting in SETTINGS:
            counts = Counter(kind_of[each.experiment // 2] for each in mine if each.setting == setting)
            assert all(abs(counts[kind] - kinds.count(kind) / 2) < 1 for kind in set(kinds))


def test_orders_differ_and_are_the_same_again() -> None:
    _, _, plan = plans((40, 20, 0))
    assert plans((40, 20, 0))[2] == plan
    assert len({tuple(mine) for mine in plan}) == len(plan)
    assert plans((40, 20, 5))[2] != plan
    first = [mine[0].setting for mine in plan]
    assert set(first) == set(SETTINGS)


def test_practice_has_each_setting_once() -> None:
    mine = practice(np.array([4, 9, 11]), settings_of(2, 1, 0))
    assert [each.setting for each in mine] == list(SETTINGS)
    assert {each.experiment // 2 for each in mine} <= {4, 9, 11}


def test_too_few_pairs_and_odd_numbers_are_refused() -> None:
    with pytest.raises(CophyError, match="larger size"):
        chosen_pairs(np.arange(3), KINDS[:3], settings_of(4, 2, 0))
    with pytest.raises(ValueError, match="multiple"):
        settings_of(30, 20, 0)
