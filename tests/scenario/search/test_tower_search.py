from collections.abc import Callable

import numpy as np
import pytest

from cophy.scenario import Blocktower, Scenario
from cophy.scenario.statics import Combinations
from cophy.scenario.towers import TOWER_CELLS, TowerCell, is_identifiable, read_tower

KINDS = ["displace_x", "displace_y", "remove_top"]


@pytest.fixture
def blocktower(scenario_of: Callable[..., Scenario]) -> Blocktower:
    found = scenario_of("blocktower")
    assert isinstance(found, Blocktower)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_outcomes_of_proposals_are_open_and_true(kind: str, blocktower: Blocktower) -> None:
    found = blocktower.tower_search.propose(kind, 3, np.random.default_rng(0))
    smallest, largest = blocktower.stable_fraction
    assert len(found.level) > 100
    for stands, towers in zip((found.falls_from == 3, found.stands), found.towers, strict=True):
        share = stands.mean(axis=1)
        assert ((share >= smallest) & (share <= largest)).all()
        margins = blocktower.statics.margins(*towers, blocktower.statics.combinations(3))
        np.testing.assert_array_equal(margins > 0, stands)


@pytest.mark.parametrize("kind", KINDS)
def test_a_proposed_c_is_a_under_the_do_operation(kind: str, blocktower: Blocktower) -> None:
    found = blocktower.tower_search.propose(kind, 3, np.random.default_rng(1))
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
    scene, do_operation = next(
        blocktower.tower_search.candidates(twins, cell, kind, (3, 0, 1), np.random.default_rng(0))
    )
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
    search = blocktower.tower_search.candidates(
        (confounders, confounders), TOWER_CELLS[0], "displace_x", (0, 1, 2), np.random.default_rng(0)
    )
    assert list(search) == []
