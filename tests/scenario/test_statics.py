"""The criterion on paper, against cases worked out by hand and against simulation."""

import numpy as np
import pytest

from cophy.scenario import Blocktower, Simulator
from cophy.scenario.confounders import Confounders
from cophy.scenario.experiment import with_confounders
from cophy.scenario.statics import Combinations, joint_margins

LEVEL = np.zeros((1, 2))


def margin(xy: list[list[float]], yaw: list[float], mass: list[float], tilt: tuple[float, float] = (0.0, 0.0)) -> float:
    return float(joint_margins(np.array([xy]), np.array([yaw]), np.array([mass]), np.array([tilt])).min())


def test_a_straight_tower_stands_by_half_a_block() -> None:
    assert margin([[0, 0], [0, 0]], [0, 0], [1, 1]) == pytest.approx(0.5)


def test_an_overhang_leaves_what_remains_to_the_edge() -> None:
    assert margin([[0, 0], [0.3, 0]], [0, 0], [1, 1]) == pytest.approx(0.2)
    assert margin([[0, 0], [0.6, 0]], [0, 0], [1, 1]) == pytest.approx(-0.1)


def test_a_turned_face_reaches_further_at_its_corner() -> None:
    assert margin([[0, 0], [0.6, 0]], [np.pi / 4, np.pi / 4], [1, 1]) == pytest.approx(0.5 - 0.6 / np.sqrt(2))


def test_a_heavy_top_counterweights() -> None:
    xy = [[0, 0], [0.6, 0], [0.0, 0]]
    assert margin(xy, [0, 0, 0], [1, 1, 1]) == pytest.approx(-0.1)  # the top stands 0.6 from its block's centre
    leaning = [[0, 0], [0.6, 0], [0.3, 0]]
    assert margin(leaning, [0, 0, 0], [1, 10, 1]) < 0 < margin(leaning, [0, 0, 0], [1, 1, 10])


def test_tilted_gravity_moves_the_centre_by_its_height() -> None:
    # one block: its centre is half a block above the ground
    assert margin([[0, 0]], [0], [1], (0.1, 0.0)) == pytest.approx(0.5 - 0.05)
    # two blocks: their common centre is a whole block above the ground
    assert margin([[0, 0], [0, 0]], [0, 0], [1, 1], (0.1, 0.0)) == pytest.approx(0.5 - 0.1)


def test_only_mass_ratios_matter() -> None:
    xy, yaw = [[0, 0], [0.3, 0.1], [0.5, -0.1]], [0.1, 0.7, 1.2]
    assert margin(xy, yaw, [1, 10, 1]) == pytest.approx(margin(xy, yaw, [10, 100, 10]))


def test_a_tower_without_its_top_has_the_masses_of_what_is_left(scenario_of) -> None:
    statics = scenario_of("blocktower").statics
    every = statics.combinations(3)
    assert every.mass.shape == (72, 3)
    assert sorted(set(every.tilt.ravel().round(6).tolist())) == [-0.1, 0.0, 0.1]
    left = statics.margins(np.array([[[0.0, 0.0], [0.3, 0.0]]]), np.zeros((1, 2)), every)
    by_hand = joint_margins(np.array([[[0.0, 0.0], [0.3, 0.0]]]), np.zeros((1, 2)), every.mass[:, :2], every.tilt)
    np.testing.assert_array_equal(left, by_hand.min(axis=-1))


def test_a_tower_is_sure_to_fall_from_its_highest_joint_that_gives_way(scenario_of) -> None:
    statics = scenario_of("blocktower").statics
    upright = Combinations(np.ones((1, 3)), LEVEL)
    xy = np.array(
        [
            [[0, 0], [0, 0], [0, 0]],
            [[0, 0], [0, 0], [0.6, 0]],
            [[0, 0], [0.4, 0], [0.85, 0]],
            [[0, 0], [0.3, 0], [0.9, 0]],
        ]
    )
    # the last two fail at the middle joint; in the last the top goes first, and may leave the middle block standing
    assert statics.falls_from(xy, np.zeros((4, 3)), upright)[:, 0].tolist() == [3, 2, 1, 2]
    assert (statics.margins(xy, np.zeros((4, 3)), upright) > 0)[:, 0].tolist() == [True, False, False, False]


def agreement(blocktower: Blocktower, simulator: Simulator, *, towers: int, num_levels: int, seed: int) -> np.ndarray:
    """(tower, 2): margin on paper, and whether simulation agrees; half of the towers stand on paper."""
    rng, rows = np.random.default_rng(seed), []
    while len(rows) < towers:
        tower = blocktower.sample_towers(num_levels, rng).select(np.array([0]))
        mass, friction = rng.choice([1.0, 10.0], num_levels), rng.choice([0.5, 1.0], num_levels)
        gravity = rng.choice([-1.0, 0.0, 1.0], 2)
        margins = blocktower.statics.margins(*tower, Combinations(mass[None], gravity[None] / 10.0))
        if (margins[0, 0] > 0) == len(rows) % 2:
            continue
        confounders = Confounders(tuple(mass), tuple(friction), (0.0,) * num_levels, tuple(gravity))
        scene = with_confounders(
            tower.scene(0, tuple(range(num_levels)), block_size=blocktower.block_size, gravity_z=blocktower.gravity_z),
            confounders,
        )
        stands = blocktower.statics.stands(blocktower.simulate(simulator, scene))
        rows.append((margins[0, 0], stands == (margins[0, 0] > 0)))
    return np.array(rows)


@pytest.mark.parametrize(("towers", "most_wrong"), [(24, 2), pytest.param(100, 3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("num_levels", [3, 4])
def test_simulation_agrees_with_the_criterion(
    scenario_of, simulator: Simulator, num_levels: int, towers: int, most_wrong: int
) -> None:
    blocktower = scenario_of("blocktower")
    rows = agreement(blocktower, simulator, towers=towers, num_levels=num_levels, seed=2)
    assert rows[np.abs(rows[:, 0]) >= blocktower.min_margin, 1].all()
    assert (rows[:, 1] == 0).sum() <= most_wrong
