"""Whether AB settles if C stands, against cases worked out by hand."""

import numpy as np

from cophy.scenario.statics import Combinations
from cophy.scenario.towers import is_identifiable

# masses of two blocks, 1 or 10 each, under upright gravity, then under tilted gravity
MASS = np.array([[1, 1], [1, 10], [10, 1], [10, 10]] * 2, dtype=float)
EVERY = Combinations(MASS, np.repeat([[0.0, 0.0], [0.1, 0.0]], 4, axis=0))
STANDS = 2


def tells(falls_from: list[int], stands: list[bool]) -> list[bool]:
    return is_identifiable(np.array([falls_from]), np.array([stands]), EVERY)[0].tolist()


def test_a_tower_that_stands_shows_nothing_else() -> None:
    assert tells([STANDS] * 8, [True] * 8) == [True] * 8
    assert tells([STANDS] * 8, [True] * 7 + [False]) == [False] * 8


def test_to_stand_is_told_from_to_fall() -> None:
    assert tells([STANDS] * 4 + [1] * 4, [True] * 4 + [False] * 4) == [True] * 8


def test_a_top_that_falls_shows_gravity_but_no_mass() -> None:
    assert tells([1] * 8, [True] * 4 + [False] * 4) == [True] * 8
    assert tells([1] * 8, [True, False, True, True] + [False] * 4) == [False] * 4 + [True] * 4


def test_blocks_that_fall_show_the_ratio_of_their_masses() -> None:
    light_below, heavy_below = [False, True, False, False], [False, False, True, False]
    assert tells([0] * 8, light_below + heavy_below) == [True] * 8
    scale = [True, False, False, False]  # equal masses, but light
    assert tells([0] * 8, scale + [False] * 4) == [False, True, True, False] + [True] * 4


def test_every_tower_is_judged_alone() -> None:
    found = is_identifiable(np.full((2, 8), STANDS), np.array([[True] * 8, [True, False] * 4]), EVERY)
    assert found.all(axis=1).tolist() == [True, False]
    assert not found[1].any()
