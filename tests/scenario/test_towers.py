"""Search for towers by statics."""

from collections.abc import Callable

import numpy as np
import pytest

from cophy.scenario import Blocktower, Scenario
from cophy.scenario.statics import Combinations
from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS, TowerCell, Towers, is_identifiable, read_tower

LEANING = Towers(np.array([[[0.0, 0.0], [0.3, -0.1], [0.2, 0.4]]]), np.array([[0.1, 0.7, 1.2]]))


def test_a_tower_is_the_same_before_and_after_it_is_a_scene() -> None:
    scene = LEANING.scene(0, (2, 0, 1), block_size=1.0, gravity_z=-10.0)
    assert [block.slot for block in scene.objects] == [2, 0, 1]
    assert [block.position[2] for block in scene.objects] == [0.5, 1.5, 2.5]
    for found, expected in zip(read_tower(scene), LEANING, strict=True):
        np.testing.assert_allclose(found, expected)


def test_a_top_is_put_on_every_tower() -> None:
    higher = LEANING.with_top(np.array([[1.0, 2.0]]), np.array([0.5]))
    np.testing.assert_array_equal(higher.xy[0, -1], [1.0, 2.0])
    assert higher.yaw.tolist() == [[0.1, 0.7, 1.2, 0.5]]


def test_cells_have_names_and_come_with_those_of_their_twins() -> None:
    one_stands = ["stands_stands", "falls_falls", "stands_falls", "falls_stands"]
    assert [cell.name for cell in TOWER_CELLS] == [*one_stands, "both_fall_stands", "both_fall_falls"]
    assert {cell.twin for cell in TOWER_CELLS} == set(TOWER_CELLS)
    assert TowerCell(True, False, twin_observed=False).twin == TowerCell(False, True, twin_observed=True)


def test_a_falls_under_both_twins_in_four_fifths_of_the_pairs() -> None:
    cells = [TOWER_CELLS[index] for block in TOWER_BLOCKS for index in block]
    assert np.mean([not (cell.observed or cell.twin_observed) for cell in cells]) == 0.8


def test_both_configurations_of_a_block_meet_both_outcomes_of_c() -> None:
    for first, second in TOWER_BLOCKS:
        assert TOWER_CELLS[second] == TOWER_CELLS[first].twin


KINDS = ["displace_x", "displace_y", "remove_top"]


@pytest.fixture
def blocktower(scenario_of: Callable[..., Scenario]) -> Blocktower:
    found = scenario_of("blocktower")
    assert isinstance(found, Blocktower)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_outcomes_of_proposals_are_open_and_true(kind: str, blocktower: Blocktower) -> None:
    found = blocktower.propose(kind, 3, np.random.default_rng(0))
    smallest, largest = blocktower.stable_fraction
    assert len(found.level) > 100
    for stands, towers in zip((found.falls_from == 3, found.stands), found.towers, strict=True):
        share = stands.mean(axis=1)
        assert ((share >= smallest) & (share <= largest)).all()
        margins = blocktower.statics.margins(*towers, blocktower.statics.combinations(3))
        np.testing.assert_array_equal(margins > 0, stands)


@pytest.mark.parametrize("kind", KINDS)
def test_a_proposed_c_is_a_under_the_do_operation(kind: str, blocktower: Blocktower) -> None:
    found = blocktower.propose(kind, 3, np.random.default_rng(1))
    a, c = found.towers
    if kind == "remove_top":
        np.testing.assert_array_equal(a.xy[:, :2], c.xy)
        assert (found.level == 2).all()
    else:
        moved = np.zeros_like(a.xy)
        moved[np.arange(len(found.level)), found.level] = found.offset
        np.testing.assert_allclose(c.xy - a.xy, moved, atol=1e-12)
        assert (found.offset[:, 0 if kind == "displace_y" else 1] == 0).all()


@pytest.mark.parametrize("cell", TOWER_CELLS)
@pytest.mark.parametrize("kind", KINDS)
def test_candidates_fill_the_cell_and_its_twin_on_paper(kind: str, cell: TowerCell, blocktower: Blocktower) -> None:
    grid, statics = blocktower.confounders, blocktower.statics
    twins = (grid.decode(0, 3), grid.decode(grid.num_configurations(3) - 1, 3))
    scene, do_operation = next(blocktower.candidates(twins, cell, kind, (3, 0, 1), np.random.default_rng(0)))
    towers = [read_tower(scene), read_tower(do_operation.apply(scene))]
    every = statics.combinations(3)
    margins = np.stack([statics.margins(*tower, every)[0] for tower in towers])
    for confounders, expected in zip(twins, (cell, cell.twin), strict=True):
        own = (every.mass == confounders.mass).all(axis=1) & np.isclose(every.tilt * 10, confounders.gravity_xy).all(
            axis=1
        )
        assert tuple(margins[:, own][:, 0] > 0) == expected[:2]
        assert (np.abs(margins[:, own]) >= blocktower.min_margin - 1e-9).all()
    falls_from = statics.falls_from(*towers[0], every)
    tells = is_identifiable(falls_from, margins[1:] > 0, every)[0]
    assert all(
        tells[every.nearest(Combinations(np.array([own.mass]), np.array([own.gravity_xy]) / 10))] for own in twins
    )
    assert do_operation.kind == kind


def test_twins_that_no_tower_tells_apart_have_no_candidates(blocktower: Blocktower) -> None:
    confounders = blocktower.confounders.decode(0, 3)
    search = blocktower.candidates(
        (confounders, confounders), TOWER_CELLS[0], "displace_x", (0, 1, 2), np.random.default_rng(0)
    )
    assert list(search) == []


# masses of two blocks, 1 or 10 each, under upright gravity, then under tilted gravity
MASS = np.array([[1, 1], [1, 10], [10, 1], [10, 10]] * 2, dtype=float)
EVERY = Combinations(MASS, np.repeat([[0.0, 0.0], [0.1, 0.0]], 4, axis=0))
STANDS = 2


def identifiable(falls_from: list[int], stands: list[bool]) -> list[bool]:
    return is_identifiable(np.array([falls_from]), np.array([stands]), EVERY)[0].tolist()


def test_a_tower_that_stands_shows_nothing_else() -> None:
    assert identifiable([STANDS] * 8, [True] * 8) == [True] * 8
    assert identifiable([STANDS] * 8, [True] * 7 + [False]) == [False] * 8


def test_to_stand_is_told_from_to_fall() -> None:
    assert identifiable([STANDS] * 4 + [1] * 4, [True] * 4 + [False] * 4) == [True] * 8


def test_a_top_that_falls_shows_gravity_but_no_mass() -> None:
    assert identifiable([1] * 8, [True] * 4 + [False] * 4) == [True] * 8
    assert identifiable([1] * 8, [True, False, True, True] + [False] * 4) == [False] * 4 + [True] * 4


def test_blocks_that_fall_show_the_ratio_of_their_masses() -> None:
    light_below, heavy_below = [False, True, False, False], [False, False, True, False]
    assert identifiable([0] * 8, light_below + heavy_below) == [True] * 8
    scale = [True, False, False, False]  # equal masses, but light
    assert identifiable([0] * 8, scale + [False] * 4) == [False, True, True, False] + [True] * 4


def test_every_tower_is_judged_alone() -> None:
    found = is_identifiable(np.full((2, 8), STANDS), np.array([[True] * 8, [True, False] * 4]), EVERY)
    assert found.all(axis=1).tolist() == [True, False]
    assert not found[1].any()
