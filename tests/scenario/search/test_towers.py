import numpy as np
import pytest

from cophy.scenario.search.towers import TOWER_CELLS, TowerCell, Towers, agreement, tower_of

LEANING = Towers(np.array([[[0.0, 0.0], [0.3, -0.1], [0.2, 0.4]]]), np.array([[0.1, 0.7, 1.2]]))


def test_a_tower_is_the_same_before_and_after_it_is_a_scene() -> None:
    scene = LEANING.scene(0, (2, 0, 1), block_size=1.0, gravity_z=-10.0)
    assert [block.slot for block in scene.objects] == [2, 0, 1]
    assert [block.position[2] for block in scene.objects] == [0.5, 1.5, 2.5]
    for found, expected in zip(tower_of(scene), LEANING, strict=True):
        np.testing.assert_allclose(found, expected)


def test_a_top_is_put_on_every_tower() -> None:
    higher = LEANING.with_top(np.array([[1.0, 2.0]]), np.array([0.5]))
    np.testing.assert_array_equal(higher.xy[0, -1], [1.0, 2.0])
    assert higher.yaw.tolist() == [[0.1, 0.7, 1.2, 0.5]]


def test_cells_are_all_outcomes_and_come_with_their_opposites() -> None:
    assert [cell.name for cell in TOWER_CELLS] == ["stands_stands", "falls_falls", "stands_falls", "falls_stands"]
    assert {cell.opposite for cell in TOWER_CELLS} == set(TOWER_CELLS)
    assert TowerCell(True, False).opposite == TowerCell(False, True)


@pytest.mark.parametrize("cell", TOWER_CELLS)
def test_agreement_is_the_share_that_does_as_the_standing_twin_does(cell: TowerCell) -> None:
    stands = np.array([[[True, True, True, True, False], [True, False, False, False, True]]])  # A; C
    standing = cell if cell.observed else cell.opposite
    assert agreement(stands, cell).tolist() == [0.25 if standing.counterfactual else 0.75]
