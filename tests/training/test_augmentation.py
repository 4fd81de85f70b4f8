"""Symmetries of the data: of the physics, and of what the models are fed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from cophy.dataset.datamodules import DeviceShare
from cophy.dataset.features import confounder_statistics, poses, standardised
from cophy.scenario import Scenario, Simulator
from cophy.scenario.blocktower import NUM_ROTATIONS
from cophy.scenario.physics import Body, Scene, Shape, trajectory_distance
from cophy.training.augmentation import add_position_noise, augment, matrices_of, transform
from cophy.training.settings import Augmentation
from cophy.types import HORIZONTAL, Batch, take
from tests.conftest import SCENARIOS
from tests.models.networks import random_batch


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


def some(matrices: np.ndarray) -> np.ndarray:
    """Eight or nine of them, turns and reflections by all kinds of angles."""
    return matrices[:: max(1, len(matrices) // 8 - 1)]


@pytest.mark.parametrize(
    ("name", "num_objects"),
    [("collision", 2), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("blocktower", 3), ("balls", 3)))],
)
def test_a_turned_scene_moves_as_the_turned_prediction_says(
    name: str, num_objects: int, scenario_of, simulator: Simulator
) -> None:
    """What augmentation relies on: simulating the turned scene gives the turned trajectory, until chaos sets in."""
    scenario: Scenario = scenario_of(name)
    distances = []
    for index in range(8):
        experiment, _ = scenario.twin_pair(num_objects, data_seed=3, pair=index, simulator=simulator)
        start = slice(0, 20)  # the first second
        for matrix in some(scenario.augmentations()):
            again = scenario.simulate(simulator, turned(experiment.scene, matrix))
            expected = experiment.observed.states.copy()
            expected[..., :2] = experiment.observed.positions[..., :2] @ matrix.T
            pair = (replace(again, states=states[start]) for states in (expected, again.states))
            distances.append(trajectory_distance(*pair))
    assert np.median(distances) < 0.005
    assert np.quantile(distances, 0.9) < 0.05


def test_a_turned_tower_of_the_half_that_training_sees_stays_in_it(scenario_of) -> None:
    """A turned experiment has turned gravity; what is held out must not be seen that way."""
    scenario: Scenario = scenario_of("blocktower")
    grid, seen = scenario.confounders, scenario.seen_configurations(3, data_seed=0)
    half_of = {grid.decode(number, 3): half for number, half in enumerate(seen.tolist())}
    for confounders, half in half_of.items():
        found = 0
        for matrix in scenario.augmentations():
            x, y = (matrix @ confounders.gravity_xy).round(9).tolist()
            if (turned := replace(confounders, gravity_xy=(x, y))) in half_of:  # else no experiment has this gravity
                assert half_of[turned] == half
                found += 1
        assert found >= len(scenario.symmetries())


@pytest.mark.parametrize("name", SCENARIOS)
def test_symmetries_are_a_group_of_isometries(name: str, scenario_of) -> None:
    matrices = scenario_of(name).symmetries()
    np.testing.assert_array_equal(matrices[0], np.eye(2))
    as_set = {tuple(matrix.ravel()) for matrix in matrices}
    assert len(as_set) == len(matrices)
    for a in matrices:
        np.testing.assert_array_equal(a @ a.T, np.eye(2))
        assert {tuple((a @ b).ravel()) for b in matrices} == as_set


@pytest.mark.parametrize("name", SCENARIOS)
def test_augmentations_are_isometries_and_hold_every_symmetry(name: str, scenario_of) -> None:
    matrices = scenario_of(name).augmentations()
    np.testing.assert_array_equal(matrices[0], np.eye(2))
    np.testing.assert_allclose(
        matrices @ matrices.transpose(0, 2, 1), np.broadcast_to(np.eye(2), matrices.shape), atol=1e-15
    )
    for symmetry in scenario_of(name).symmetries():
        assert np.isclose(matrices, symmetry).all(axis=(1, 2)).sum() == 1


def test_physics_allows_towers_any_angle_and_all_else_what_is_as_likely(scenario_of) -> None:
    counts = {
        name: [len(matrices_of(scenario_of(name), choice)) for choice in Augmentation] for name in sorted(SCENARIOS)
    }
    assert counts == {"balls": [1, 8, 8], "blocktower": [1, 8, 2 * NUM_ROTATIONS], "collision": [1, 8, 8]}


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


@pytest.mark.parametrize("shape", Shape)
def test_a_turned_pose_is_the_pose_of_the_turned_scene(shape: Shape) -> None:
    """Of any turn, and mirrored: blocks with any yaw, cylinders with any axis."""
    rotations, rng = Rotation.random(20, random_state=0), np.random.default_rng(0)
    if shape is Shape.BOX:
        rotations = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, (20, 1)))
    bodies = [Body(shape, (1, 1, 1), (0, 0, 0), n, 1.0, quaternion_xyzw=q) for n, q in enumerate(rotations.as_quat())]
    scene, experiment = Scene(tuple(bodies), (0.0, 0.0, -10.0)), random_batch(20, [20], num_frames=2)
    batch = replace(experiment, inputs=replace(experiment.inputs, pose=pose_of(scene)))
    for angle in rng.uniform(-np.pi, np.pi, 5):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for matrix in (turn, turn @ np.diag([1.0, -1.0])):
            found = transform(batch, torch.from_numpy(matrix[None]).float()).inputs.pose
            torch.testing.assert_close(found, pose_of(turned(scene, matrix)), atol=1e-5, rtol=0)


def pose_of(scene: Scene) -> torch.Tensor:
    """(1, object, feature)."""
    states = np.zeros((1, 2, 1, len(scene.objects), 13))
    states[..., 3:7] = [body.quaternion_xyzw for body in scene.objects]
    return poses({"states": states, "shape": np.array([[body.shape for body in scene.objects]])})


def test_every_augmentation_is_drawn(tower_batch: Batch, scenario_of) -> None:
    matrices = torch.from_numpy(scenario_of("balls").augmentations()).float()
    drawn = (augment(tower_batch, matrices, (step,)).inputs.initial[0, :, :2] for step in range(100))
    assert len({tuple(xy.flatten().tolist()) for xy in drawn}) == 8


def test_noise_is_as_large_as_asked_and_d_stays_true() -> None:
    batch = random_batch(4, [4] * 300, num_frames=20)
    seen = add_position_noise(batch, 0.1, (0, 1, 2))
    assert seen.targets is batch.targets
    torch.testing.assert_close(add_position_noise(batch, 0.1, (0, 1, 2)).inputs.observed, seen.inputs.observed)
    for draw in ((1, 1, 2), (0, 2, 2), (0, 1, 3)):
        assert not torch.equal(add_position_noise(batch, 0.1, draw).inputs.observed, seen.inputs.observed)
    deviation = (seen.inputs.observed - batch.inputs.observed).std(dim=(1, 2, 3))
    assert 0.1 < deviation.max() < 0.12  # with an estimate's own spread
    assert 0.045 < deviation.mean() < 0.055
    assert deviation.min() < 0.01  # nearly true ones are among them
    absent = torch.zeros_like(batch.inputs.presence)
    some = replace(batch, inputs=replace(batch.inputs, presence=absent, observed_presence=absent))
    assert torch.equal(
        add_position_noise(some, 0.1, (0, 1, 2)).inputs.observed, batch.inputs.observed
    )  # empty slots stay zero
    off = seen.inputs.initial - batch.inputs.initial
    torch.testing.assert_close(off.std(), torch.tensor(0.1 / 3**0.5), rtol=0.1, atol=0)
    for device in range(2):
        half = take(batch, slice(device, None, 2))
        torch.testing.assert_close(
            add_position_noise(half, 0.1, (0, 1, 2), DeviceShare(2, device)).inputs.observed,
            seen.inputs.observed[device::2],
        )
