"""Symmetries of the data: of the physics, and of what the models are fed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cophy.dataset.counterfactual import confounder_statistics, standardise
from cophy.scenario import Scenario, Simulator
from cophy.scenario.scene import Body, Scene, trajectory_distance
from cophy.training.augmentation import augment, transform
from cophy.types import HORIZONTAL, Batch
from tests.conftest import SCENARIOS


def turned(scene: Scene, matrix: np.ndarray) -> Scene:
    """The scene in other coordinates; only for objects whose shape does not change by it (balls)."""

    def body(body: Body) -> Body:
        position, velocity = ((*(matrix @ v[:2]), v[2]) for v in (body.position, body.linear_velocity))
        return replace(body, position=position, linear_velocity=velocity)

    return replace(scene, bodies=tuple(body(b) if b.slot is not None else b for b in scene.bodies))


def test_turned_balls_move_as_the_turned_prediction_says(scenario_of, simulator: Simulator) -> None:
    """What augmentation relies on: simulating the turned scene gives the turned trajectory, until chaos sets in."""
    scenario: Scenario = scenario_of("balls", "scenario.clock.num_frames=6")
    pair = [scenario.twin_pair(3, seed=3, pair=index, simulator=simulator)[0] for index in range(4)]
    for experiment in pair:
        original = scenario.simulate(simulator, experiment.scene)
        for matrix in scenario.symmetries():
            again = scenario.simulate(simulator, turned(experiment.scene, matrix))
            expected = original.states.copy()
            expected[..., :2] = original.positions[..., :2] @ matrix.T
            assert trajectory_distance(replace(original, states=expected), again) < 0.05


@pytest.mark.parametrize("name", SCENARIOS)
def test_symmetries_are_a_group_of_isometries(name: str, scenario_of) -> None:
    matrices = scenario_of(name).symmetries()
    np.testing.assert_array_equal(matrices[0], np.eye(2))
    as_set = {tuple(matrix.ravel()) for matrix in matrices}
    assert len(as_set) == len(matrices)
    for a in matrices:
        np.testing.assert_array_equal(a @ a.T, np.eye(2))
        assert {tuple((a @ b).ravel()) for b in matrices} == as_set


def test_a_quarter_turn_turns_everything(tower_batch: Batch) -> None:
    quarter = torch.tensor([[0.0, -1.0], [1.0, 0.0]]).expand(len(tower_batch.initial), 2, 2)
    batch = transform(tower_batch, quarter)
    for name in ("observed", "initial", "target"):
        before, after = getattr(tower_batch, name), getattr(batch, name)
        torch.testing.assert_close(after, torch.stack([-before[..., 1], before[..., 0], before[..., 2]], dim=-1))
    for x, y in HORIZONTAL:
        torch.testing.assert_close(batch.confounders[..., x], -tower_batch.confounders[..., y])
        torch.testing.assert_close(batch.confounders[..., y], tower_batch.confounders[..., x])
    assert batch.stable is tower_batch.stable


def test_turning_and_scaling_confounders_commute(tower_batch: Batch) -> None:
    """Standardised gravity, turned, is turned gravity, standardised."""
    statistics = confounder_statistics(tower_batch)
    quarter = torch.tensor([[0.0, -1.0], [1.0, 0.0]]).expand(len(tower_batch.initial), 2, 2)
    one = transform(standardise(tower_batch, statistics), quarter).confounders
    other = standardise(transform(tower_batch, quarter), statistics).confounders
    torch.testing.assert_close(one, other)


def test_every_symmetry_is_drawn(tower_batch: Batch, scenario_of) -> None:
    torch.manual_seed(0)
    symmetries = torch.from_numpy(scenario_of("blocktower").symmetries()).float()
    seen = {tuple(augment(tower_batch, symmetries).initial[0, :, :2].flatten().tolist()) for _ in range(100)}
    assert len(seen) == 8
