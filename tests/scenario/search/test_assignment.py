from collections import Counter

import numpy as np

from cophy.scenario.search.assignment import assign, seen_configurations

TOWERS = {"data_seed": 0, "num_configurations": 576, "num_do_operations": 3, "num_cells": 4}


def test_an_assignment_is_a_pure_function_of_its_index() -> None:
    assert assign(17, **TOWERS) == assign(17, **TOWERS)
    assert assign(17, **TOWERS) != assign(17, **(TOWERS | {"data_seed": 1}))


def test_every_configuration_meets_every_cell_equally_often() -> None:
    met = Counter((assign(pair, **TOWERS).first, assign(pair, **TOWERS).cell) for pair in range(4 * 576))
    assert len(met) == 4 * 576
    assert set(met.values()) == {1}


def test_configurations_of_the_second_twin_are_level_too() -> None:
    seconds = Counter(assign(pair, **TOWERS).seconds[0] for pair in range(0, 4 * 576, 4))
    assert set(seconds.values()) == {1}


def test_both_twins_come_from_the_same_half_of_the_configurations() -> None:
    seen = seen_configurations(576, data_seed=0)
    assert seen.sum() == 288
    for pair in range(0, 200):
        assignment = assign(pair, **TOWERS)
        assert (seen[list(assignment.seconds)] == seen[assignment.first]).all()
        assert assignment.first not in assignment.seconds


def test_do_operations_are_level_within_each_half() -> None:
    seen = seen_configurations(576, data_seed=0)
    kinds = Counter(
        (bool(seen[assign(pair, **TOWERS).first]), assign(pair, **TOWERS).do_operation) for pair in range(0, 2400, 4)
    )
    assert len(kinds) == 6
    assert np.ptp(list(kinds.values())) == 0
