"""Symmetries of the data: of the physics, and of what the models are fed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from cophy.dataset.feed.confounder_features import confounder_statistics, standardised
from cophy.dataset.splits import Part
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics.scene import Body, Scene, trajectory_distance
from cophy.training.augmentation import augment, symmetries_for, transform
from cophy.types import HORIZONTAL, Batch
from tests.conftest import SCENARIOS


def turned(scene: Scene, matrix: np.ndarray) -> Scene:
    """The scene in other coordinates; a mirrored body is its own mirror image, as blocks, balls and cylinders are."""
    whole = np.eye(3)
    whole[:2, :2] = matrix
    handed = np.diag([1.0, np.linalg.det(matrix), 1.0])

    def body(body: Body) -> Body:
        position, velocity = (tuple(whole @ vector) for vector in (body.position, body.linear_velocity))
        orientation = whole @ Rotation.from_quat(body.quaternion_xyzw).as_matrix() @ handed
        quaternion = tuple(Rotation.from_matrix(orientation).as_quat())
        return replace(body, position=position, linear_velocity=velocity, quaternion_xyzw=quaternion)

    bodies = tuple(body(b) if b.slot is not None else b for b in scene.bodies)
    return replace(scene, bodies=bodies, gravity=tuple(whole @ scene.gravity))


@pytest.mark.parametrize(("name", "num_objects"), [("blocktower", 3), ("balls", 3), ("collision", 2)])
def test_a_turned_scene_moves_as_the_turned_prediction_says(
    name: str, num_objects: int, scenario_of, simulator: Simulator
) -> None:
    """What augmentation relies on: simulating the turned scene gives the turned trajectory, until chaos sets in."""
    scenario: Scenario = scenario_of(name)
    distances = []
    for index in range(4):
        experiment, _ = scenario.twin_pair(num_objects, data_seed=3, pair=index, simulator=simulator)
        start = slice(0, 30)  # the first one and a half seconds
        for matrix in scenario.symmetries():
            again = scenario.simulate(simulator, turned(experiment.scene, matrix))
            expected = experiment.observed.states.copy()
            expected[..., :2] = experiment.observed.positions[..., :2] @ matrix.T
            pair = (replace(again, states=states[start]) for states in (expected, again.states))
            distances.append(trajectory_distance(*pair))
    assert np.median(distances) < 0.005
    assert np.quantile(distances, 0.9) < 0.05


def test_training_on_seen_configurations_turns_nothing(scenario_of) -> None:
    """A turned experiment has turned gravity: for K = 3 most unseen configurations would be seen."""
    scenario = scenario_of("blocktower")
    assert len(symmetries_for(Part(3), scenario)) == 8
    np.testing.assert_array_equal(symmetries_for(Part(3, configurations="seen"), scenario), [np.eye(2)])


@pytest.mark.parametrize("name", SCENARIOS)
def test_symmetries_are_a_group_of_isometries(name: str, scenario_of) -> None:
    matrices = scenario_of(name).symmetries()
    np.testing.assert_array_equal(matrices[0], np.eye(2))
    as_set = {tuple(matrix.ravel()) for matrix in matrices}
    assert len(as_set) == len(matrices)
    for a in matrices:
        np.testing.assert_array_equal(a @ a.T, np.eye(2))
        assert {tuple((a @ b).ravel()) for b in matrices} == as_set


def quarter_turns(batch: Batch) -> torch.Tensor:
    return torch.tensor([[0.0, -1.0], [1.0, 0.0]]).expand(len(batch), 2, 2)


def test_a_quarter_turn_turns_everything(tower_batch: Batch) -> None:
    batch = transform(tower_batch, quarter_turns(tower_batch))
    before, after = tower_batch.inputs, batch.inputs
    pairs = [(before.observed, after.observed), (before.initial, after.initial)]
    pairs += [
        (tower_batch.targets.position, batch.targets.position),
        (tower_batch.targets.initial, batch.targets.initial),
    ]
    for one, other in pairs:
        torch.testing.assert_close(other, torch.stack([-one[..., 1], one[..., 0], one[..., 2]], dim=-1))
    for x, y in HORIZONTAL:
        torch.testing.assert_close(after.confounders[..., x], -before.confounders[..., y])
        torch.testing.assert_close(after.confounders[..., y], before.confounders[..., x])
    assert batch.targets.stable is tower_batch.targets.stable


def test_turning_and_scaling_confounders_commute(tower_batch: Batch) -> None:
    """Standardised gravity, turned, is turned gravity, standardised."""
    inputs = tower_batch.inputs
    statistics = confounder_statistics(inputs.confounders, inputs.observed_presence)

    def scaled(batch: Batch) -> Batch:
        values = standardised(batch.inputs.confounders, inputs.observed_presence, statistics)
        return replace(batch, inputs=replace(batch.inputs, confounders=values))

    quarter = quarter_turns(tower_batch)
    one, other = transform(scaled(tower_batch), quarter), scaled(transform(tower_batch, quarter))
    torch.testing.assert_close(one.inputs.confounders, other.inputs.confounders)


def test_every_symmetry_is_drawn(tower_batch: Batch, scenario_of) -> None:
    torch.manual_seed(0)
    symmetries = torch.from_numpy(scenario_of("blocktower").symmetries()).float()
    drawn = (augment(tower_batch, symmetries).inputs.initial[0, :, :2] for _ in range(100))
    assert len({tuple(xy.flatten().tolist()) for xy in drawn}) == 8
