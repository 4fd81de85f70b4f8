"""The half of the towers' configurations that † splits hold out."""

import itertools

import numpy as np
import pytest

from cophy.scenario.assignment import canonical_problems, select_seen
from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.scenario import square_symmetries

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
    half_of = {(tuple(m), tuple(g)): half for m, g, half in zip(mass, gravity, seen, strict=True)}
    for m, g, half in zip(mass, gravity, seen, strict=True):
        for matrix, factor in itertools.product(square_symmetries(), (0.1, 0.2, 0.5, 1, 2, 5, 10)):
            assert half_of.get((tuple(np.round(factor * m, 6)), tuple(matrix @ g)), half) == half


@pytest.mark.parametrize("data_seed", range(10))
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
