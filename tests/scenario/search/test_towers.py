import numpy as np

from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS, TowerCell, Towers, read_tower

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
