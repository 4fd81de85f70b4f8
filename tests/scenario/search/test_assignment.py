from collections import Counter

import numpy as np
import pytest

from cophy.scenario.assignment import assign

SEEN = np.random.default_rng(0).permutation(576) < 288
ONE_BLOCK = {
    "data_seed": 0,
    "num_configurations": 576,
    "seen": SEEN,
    "num_do_operations": 3,
    "blocks": ((0, 1, 2, 3),),
}
THREE_BLOCKS = ONE_BLOCK | {"blocks": ((4, 5), (0, 1), (2, 3))}


def test_an_assignment_is_a_pure_function_of_its_index() -> None:
    assert assign(17, **ONE_BLOCK) == assign(17, **ONE_BLOCK)
    assert assign(17, **ONE_BLOCK) != assign(17, **(ONE_BLOCK | {"data_seed": 1}))


def test_every_configuration_meets_every_cell_of_the_one_block_equally_often() -> None:
    met = Counter((assign(pair, **ONE_BLOCK).first, assign(pair, **ONE_BLOCK).cell) for pair in range(4 * 576))
    assert len(met) == 4 * 576
    assert set(met.values()) == {1}


def test_both_cells_of_a_block_are_met_by_the_same_twins() -> None:
    for pair in range(0, 200, 2):
        first, second = assign(pair, **THREE_BLOCKS), assign(pair + 1, **THREE_BLOCKS)
        assert (first.first, first.seconds, first.do_operation) == (second.first, second.seconds, second.do_operation)
        assert (first.cell, second.cell) in THREE_BLOCKS["blocks"]


@pytest.mark.parametrize("num_do_operations", [1, 2, 3, 6])
def test_kinds_of_block_meet_kinds_of_do_operation_equally_often(num_do_operations: int) -> None:
    prescribed = THREE_BLOCKS | {"num_do_operations": num_do_operations}
    pairs = [assign(pair, **prescribed) for pair in range(2 * 2 * 6 * 18)]
    met = Counter((bool(SEEN[pair.first]), pair.cell, pair.do_operation) for pair in pairs)
    assert len(met) == 2 * 6 * num_do_operations
    assert np.ptp(list(met.values())) == 0


def test_configurations_of_the_second_twin_are_level_too() -> None:
    seconds = Counter(assign(pair, **ONE_BLOCK).seconds[0] for pair in range(0, 4 * 576, 4))
    assert set(seconds.values()) == {1}


def test_both_twins_come_from_the_same_half_of_the_configurations() -> None:
    for pair in range(0, 200):
        assignment = assign(pair, **ONE_BLOCK)
        assert (SEEN[list(assignment.seconds)] == SEEN[assignment.first]).all()
        assert assignment.first not in assignment.seconds


@pytest.mark.parametrize("count", [11_664, 40_000])  # towers of four with three masses; more than are gone through
def test_halves_hold_among_more_configurations_too(count: int) -> None:
    seen = np.random.default_rng(0).permutation(count) < count // 2
    for pair in range(0, 80, 4):
        assignment = assign(pair, **(ONE_BLOCK | {"seen": seen, "num_configurations": count}))
        assert (seen[list(assignment.seconds)] == seen[assignment.first]).all()
        assert seen[assignment.first] == pair // 4 % 2


def test_where_nothing_is_held_out_twins_come_from_all_configurations() -> None:
    prescribed = ONE_BLOCK | {"seen": None, "num_configurations": 16}
    assert {assign(pair, **prescribed).first for pair in range(0, 4 * 16, 4)} == set(range(16))
    assert len(assign(0, **prescribed).seconds) == 15


def test_among_hundreds_of_millions_of_configurations_any_are_drawn() -> None:
    """Six balls with the released grid."""
    prescribed = ONE_BLOCK | {"seen": None, "num_configurations": 27**6}
    firsts = [assign(pair, **prescribed).first for pair in range(0, 4 * 200, 4)]
    assert len(set(firsts)) == 200
    assert 0.4 < np.mean(firsts) / 27**6 < 0.6
    assert assign(4, **prescribed) != assign(8, **prescribed)
    assert assign(4, **prescribed).first == assign(5, **prescribed).first
