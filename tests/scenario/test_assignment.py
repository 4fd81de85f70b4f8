"""What each twin pair must be: balance, blocks, and configurations held out of training."""

import itertools
from collections import Counter

import numpy as np
import pytest

from cophy.scenario.assignment import assign, block_of, canonical_problems, select_seen
from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.scenario import square_symmetries

SEEN = np.random.default_rng(0).permutation(576) < 288
ONE_BLOCK = {
    "data_seed": 0,
    "num_configurations": 576,
    "seen": SEEN,
    "num_do_operations": 3,
    "blocks": ((0, 1, 2, 3),),
}
FIRST_OF_BLOCKS = [8 * turn + half for turn in range(288) for half in (0, 1)]  # pairs alternate between the halves
THREE_BLOCKS = ONE_BLOCK | {"blocks": ((4, 5), (0, 1), (2, 3))}


def test_an_assignment_is_a_pure_function_of_its_index() -> None:
    assert assign(17, **ONE_BLOCK) == assign(17, **ONE_BLOCK)
    assert assign(17, **ONE_BLOCK) != assign(17, **(ONE_BLOCK | {"data_seed": 1}))


@pytest.mark.parametrize("count", [576, 40_000])  # more than are gone through
def test_training_tells_nothing_about_equal_numbers_of_other_series(count: int) -> None:
    seen = np.random.default_rng(0).permutation(count) < count // 2
    prescribed = ONE_BLOCK | {"seen": seen, "num_configurations": count}
    series = [[assign(pair, **prescribed, series=number) for pair in FIRST_OF_BLOCKS[:200]] for number in range(3)]
    for one, other in itertools.combinations(series, 2):
        assert sum(ours.first == others.first for ours, others in zip(one, other, strict=True)) < 10
        assert [ours.cell for ours in one] == [others.cell for others in other]


def test_every_configuration_meets_every_cell_of_the_one_block_equally_often() -> None:
    met = Counter((assign(pair, **ONE_BLOCK).first, assign(pair, **ONE_BLOCK).cell) for pair in range(4 * 576))
    assert len(met) == 4 * 576
    assert set(met.values()) == {1}


def test_both_cells_of_a_block_are_met_by_the_same_twins() -> None:
    for pair in (4 * turn + half for turn in range(50) for half in (0, 1)):
        first, second = assign(pair, **THREE_BLOCKS), assign(pair + 2, **THREE_BLOCKS)
        assert (first.first, first.seconds, first.do_operation) == (second.first, second.seconds, second.do_operation)
        assert (first.cell, second.cell) in THREE_BLOCKS["blocks"]


@pytest.mark.parametrize(("halves", "options"), [(2, THREE_BLOCKS), (1, ONE_BLOCK | {"seen": None})])
def test_pairs_of_one_block_have_one_assignment_of_configurations(halves: int, options: dict) -> None:
    pairs = np.arange(96)
    block = block_of(pairs, num_halves=halves, pairs_per_block=len(options["blocks"][0]))
    of_block: dict[int, set] = {}
    for pair, number in zip(pairs.tolist(), block.tolist(), strict=True):
        of_block.setdefault(number, set()).add((assign(pair, **options).first, assign(pair, **options).seconds))
    assert all(len(found) == 1 for found in of_block.values())
    assert len(set.union(*of_block.values())) == len(of_block) == 96 // len(options["blocks"][0])


@pytest.mark.parametrize("num_do_operations", [1, 2, 3, 6])
def test_kinds_of_block_meet_kinds_of_do_operation_equally_often(num_do_operations: int) -> None:
    prescribed = THREE_BLOCKS | {"num_do_operations": num_do_operations}
    pairs = [assign(pair, **prescribed) for pair in range(2 * 2 * 6 * 18)]
    met = Counter((bool(SEEN[pair.first]), pair.cell, pair.do_operation) for pair in pairs)
    assert len(met) == 2 * 6 * num_do_operations
    assert np.ptp(list(met.values())) == 0


def test_configurations_of_the_second_twin_are_level_too() -> None:
    seconds = Counter(assign(pair, **ONE_BLOCK).seconds[0] for pair in FIRST_OF_BLOCKS)
    assert set(seconds.values()) == {1}


def test_both_twins_come_from_the_same_half_of_the_configurations() -> None:
    for pair in range(0, 200):
        assignment = assign(pair, **ONE_BLOCK)
        assert (SEEN[list(assignment.seconds)] == SEEN[assignment.first]).all()
        assert assignment.first not in assignment.seconds


@pytest.mark.parametrize("count", [11_664, 40_000])  # towers of four with three masses; more than are gone through
def test_halves_hold_among_more_configurations_too(count: int) -> None:
    seen = np.random.default_rng(0).permutation(count) < count // 2
    for pair in range(80):
        assignment = assign(pair, **(ONE_BLOCK | {"seen": seen, "num_configurations": count}))
        assert (seen[list(assignment.seconds)] == seen[assignment.first]).all()
        assert seen[assignment.first] == pair % 2


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


TOWERS = ConfounderGrid(
    mass=[1, 10], friction=[0.5, 1], restitution=[0], gravity_x=[-1, 0, 1], gravity_y=[-1, 0, 1]
)  # as in conf/scenario/blocktower.yaml
THREE_MASSES = ConfounderGrid(mass=[1, 2, 5], friction=[0.1], restitution=[0], gravity_x=[-1, 0, 1], gravity_y=[0])


def values_of(grid: ConfounderGrid, num_objects: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, frictions and gravities of all configurations."""
    decoded = [grid.decode(number, num_objects) for number in range(grid.num_configurations(num_objects))]
    mass, friction, gravity = zip(*((each.mass, each.friction, each.gravity_xy) for each in decoded), strict=True)
    return np.array(mass), np.array(friction), np.array(gravity)


@pytest.mark.parametrize(("grid", "num_objects"), [(TOWERS, 2), (TOWERS, 3), (TOWERS, 4), (THREE_MASSES, 3)])
def test_nothing_seen_is_held_out_once_it_is_turned_or_scaled(grid: ConfounderGrid, num_objects: int) -> None:
    seen = select_seen(grid, num_objects, square_symmetries(), data_seed=0)
    mass, _, gravity = values_of(grid, num_objects)
    half_of: dict[tuple, set[bool]] = {}
    for m, g, half in zip(mass.tolist(), gravity.tolist(), seen.tolist(), strict=True):
        half_of.setdefault((tuple(m), tuple(g)), set()).add(half)
    for (m, g), half in half_of.items():
        assert len(half) == 1  # whatever the frictions
        for matrix, factor in itertools.product(square_symmetries(), (0.1, 0.2, 0.5, 1, 2, 5, 10)):
            assert half_of.get((tuple(np.round(factor * np.array(m), 6)), tuple(matrix @ g)), half) == half


@pytest.mark.parametrize("data_seed", range(3))
@pytest.mark.parametrize("num_objects", [3, 4])
def test_every_value_is_as_frequent_in_both_halves(num_objects: int, data_seed: int) -> None:
    seen = select_seen(TOWERS, num_objects, square_symmetries(), data_seed)
    assert 2 * seen.sum() == len(seen)
    for values in values_of(TOWERS, num_objects):
        for column in values.T:
            for value in np.unique(column):
                assert 2 * (column[seen] == value).sum() == (column == value).sum()


def test_a_grid_that_cannot_be_halved_exactly_is_halved_as_nearly_as_it_can() -> None:
    seen = select_seen(THREE_MASSES, 3, square_symmetries(), data_seed=0)
    assert abs(2 * seen.sum() - len(seen)) <= 1
    for values in values_of(THREE_MASSES, 3):
        for column in values.T:
            for value in np.unique(column):
                assert abs(2 * (column[seen] == value).sum() - (column == value).sum()) <= 1


def test_the_seed_says_which_half() -> None:
    first, again, other = (select_seen(TOWERS, 3, square_symmetries(), data_seed) for data_seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("num_objects", [3, 4])
def test_both_halves_have_many_problems_of_several_masses_and_gravities(num_objects: int) -> None:
    """Twins are of one half, and their masses' ratios or gravities differ."""
    seen = select_seen(TOWERS, num_objects, square_symmetries(), data_seed=0)
    mass, _, gravity = values_of(TOWERS, num_objects)
    problem = canonical_problems(mass, gravity, square_symmetries())
    for half in (seen, ~seen):
        assert len(np.unique(problem[half, :num_objects], axis=0)) >= 4
        assert len(np.unique(gravity[half], axis=0)) == 9


def test_scaled_masses_and_turned_gravity_are_the_same_problem() -> None:
    mass = np.array([[1, 10], [0.1, 1], [10, 1], [1, 1], [10, 10]])
    gravity = np.array([[1, 0], [0, -1], [1, 0], [1, 1], [-1, 1]])
    found = canonical_problems(mass, gravity, square_symmetries())
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[3], found[4])
    assert len(np.unique(found, axis=0)) == 3
