"""Inputs and targets from stored experiments, with true and with estimated positions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from cophy.config import settings
from cophy.dataset.features import (
    confounder_features,
    confounder_statistics,
    declared_inputs,
    estimated_inputs,
    not_derendered,
    object_types,
    poses,
    standardised,
    to_batch,
)
from cophy.scenario import Shape
from cophy.types import CONFOUNDERS, HORIZONTAL, OBJECT_TYPES, POSE, Batch
from tests.released.indexing import LISTS, load
from tests.released.trees import COLLISION_COLORS, CoPhyTree

RNG = np.random.default_rng(0)


def test_frames_are_every_fourth_state(tiny) -> None:
    spec, arrays = tiny
    batch = to_batch(arrays, spec.scenario)
    inputs, targets = batch.inputs, batch.targets
    num_frames = spec.scenario.clock.num_frames
    assert inputs.observed.shape[1] == num_frames
    assert targets.position.shape[1] == inputs.num_steps == num_frames - 1
    np.testing.assert_array_equal(inputs.observed[:, 7], arrays["states"][:, 0, 28, :, :3])
    np.testing.assert_array_equal(inputs.initial, arrays["states"][:, 1, 0, :, :3])
    np.testing.assert_array_equal(targets.position[:, 0], arrays["states"][:, 1, 4, :, :3])
    np.testing.assert_array_equal(targets.position[:, -1], arrays["states"][:, 1, -4, :, :3])


def test_an_object_is_stable_while_it_stays_slow_between_two_frames(tiny) -> None:
    spec, arrays = tiny
    speed = np.linalg.norm(arrays["states"][3, 1, :, :, 7:10], axis=-1)
    stable = to_batch(arrays, spec.scenario).targets.stable[3]
    for frame in (1, 12, spec.scenario.clock.num_frames - 1):
        slow = (speed[4 * frame - 3 : 4 * frame + 1] < spec.scenario.task.stable_speed).all(axis=0)
        np.testing.assert_array_equal(stable[frame - 1], slow & arrays["presence"][3, 1])


def test_what_an_empty_slot_holds_is_false(tiny) -> None:
    spec, arrays = tiny
    batch = to_batch(arrays, spec.scenario)
    assert not arrays["presence"].all()
    assert not batch.inputs.observed_stable.transpose(1, 2)[~batch.inputs.observed_presence].any()
    assert not batch.targets.stable.transpose(1, 2)[~batch.targets.presence].any()


def estimates(batch: Batch, presence_logit: np.ndarray) -> dict[str, np.ndarray]:
    """12.5 cm beside the truth."""
    whole = torch.cat([batch.targets.initial[:, None], batch.targets.position], dim=1)
    truth = torch.stack([batch.inputs.observed, whole], dim=1)
    return {"position": truth.numpy() + 0.125, "presence_logit": presence_logit.astype(np.float32)}


def seen(batch: Batch, found: dict[str, np.ndarray]) -> Batch:
    return replace(batch, inputs=estimated_inputs(found, settings("train", "scenario=blocktower").scenario))


def test_estimates_replace_what_is_seen_and_nothing_of_what_is_asked(tower_batch: Batch) -> None:
    inputs = tower_batch.inputs
    presence = torch.stack([inputs.observed_presence, inputs.presence], dim=1)[:, :, None].expand(-1, 2, 30, 4)
    found = seen(tower_batch, estimates(tower_batch, np.where(presence, 5.0, -5.0)))
    torch.testing.assert_close(found.inputs.initial, (inputs.initial + 0.125) * inputs.presence[..., None])
    expected = (inputs.observed[:, 7] + 0.125) * inputs.observed_presence[..., None]
    torch.testing.assert_close(found.inputs.observed[:, 7], expected)
    for name in ("presence", "observed_presence"):
        torch.testing.assert_close(getattr(found.inputs, name), getattr(inputs, name))


def test_estimates_change_neither_targets_nor_confounders(tiny) -> None:
    spec, arrays = tiny
    shape = (len(arrays["split"]), 2, spec.scenario.clock.num_frames, spec.scenario.num_slots)
    zeros = {"position": np.zeros((*shape, 3), np.float32), "presence_logit": np.zeros(shape, np.float32)}
    statistics = confounder_statistics(confounder_features(arrays), torch.from_numpy(arrays["presence"][:, 0]))
    true, estimated = (
        to_batch(arrays | zeros, spec.scenario, ("confounders",), statistics=statistics, estimated=estimated)
        for estimated in (False, True)
    )
    assert not estimated.inputs.observed.any()
    assert torch.equal(estimated.targets.position, true.targets.position)
    assert torch.equal(estimated.targets.presence, true.targets.presence)
    assert torch.equal(estimated.inputs.confounders, true.inputs.confounders)


def test_presence_is_that_of_most_frames_in_ab_and_of_the_only_frame_in_c(tower_batch: Batch) -> None:
    logit = np.full((len(tower_batch), 2, 30, 4), -1.0)
    logit[:, 0, :16, 0] = 1.0  # 16 of 30 frames
    logit[:, 0, :15, 1] = 1.0  # half of them
    logit[:, 1, 0, 2] = 1.0
    logit[:, 1, 1:, 3] = 1.0  # only after C
    found = seen(tower_batch, estimates(tower_batch, logit)).inputs
    assert found.observed_presence[0].tolist() == [True, False, False, False]
    assert found.presence[0].tolist() == [False, False, True, False]
    assert not found.initial[:, [0, 1, 3]].any()


def test_stability_of_ab_is_what_estimates_look_like(tower_batch: Batch) -> None:
    moving = estimates(tower_batch, np.full((len(tower_batch), 2, 30, 4), 1.0))
    moving["position"] = np.zeros_like(moving["position"])
    moving["position"][:, 0, 10:, 1, 0] = 0.03  # 3 cm in a fifth of a second: 0.15 m/s
    stable = seen(tower_batch, moving).inputs.observed_stable
    assert not stable[:, 9, 1].any()
    stable[:, 9, 1] = True
    assert stable.all()


def pose_of(shape: Shape, rotation: Rotation) -> torch.Tensor:
    """Return the pose of one object."""
    states = np.zeros((1, 2, 1, 1, 13))
    states[0, :, 0, 0, 3:7] = rotation.as_quat()
    return poses({"states": states, "shape": np.array([[shape]])})[0, 0]


def yawed(yaw: float) -> Rotation:
    return Rotation.from_euler("z", yaw)


def test_a_block_looks_the_same_after_a_quarter_turn_and_not_before() -> None:
    for yaw in RNG.uniform(-np.pi, np.pi, 10):
        pose = pose_of(Shape.BOX, yawed(yaw))
        for turns in range(4):
            torch.testing.assert_close(pose_of(Shape.BOX, yawed(yaw + turns * np.pi / 2)), pose)
        assert (pose_of(Shape.BOX, yawed(yaw + np.pi / 4)) - pose).norm() > 1.9  # as different as can be


def test_a_cylinder_looks_the_same_upside_down_and_spun_about_its_axis() -> None:
    flipped = Rotation.from_euler("x", np.pi)
    for rotation in Rotation.random(10, random_state=0):
        pose = pose_of(Shape.CYLINDER, rotation)
        spun = Rotation.from_euler("z", RNG.uniform(-np.pi, np.pi))
        torch.testing.assert_close(pose_of(Shape.CYLINDER, rotation * spun), pose)
        torch.testing.assert_close(pose_of(Shape.CYLINDER, rotation * flipped), pose)


def test_cylinders_with_other_axes_differ() -> None:
    rotations = Rotation.random(20, random_state=1)
    axes = rotations.apply([0.0, 0.0, 1.0])
    found = torch.stack([pose_of(Shape.CYLINDER, rotation) for rotation in rotations])
    lines = 1 - np.abs(axes @ axes.T)  # 0 for the same line
    apart = torch.cdist(found, found).numpy()
    others = ~np.eye(20, dtype=bool)
    assert (apart[others] > 0.5 * lines[others]).all()


def test_a_ball_shows_no_turn() -> None:
    for rotation in Rotation.random(3, random_state=2):
        assert not pose_of(Shape.SPHERE, rotation).any()


def test_types_are_one_hot_and_empty_slots_zero(tiny) -> None:
    _, arrays = tiny
    types, shape = object_types(arrays), torch.from_numpy(arrays["shape"].astype(np.int64))
    assert (types.sum(dim=-1) == (shape > 0)).all()
    for column, name in enumerate(OBJECT_TYPES):
        assert ((types[..., column] == 1) == (shape == Shape[name.upper()])).all()
    assert not poses(arrays)[shape == 0].any()


def test_a_and_c_show_the_same_pose(tiny) -> None:
    """Do-operations displace or remove, and turn nothing: so one pose is enough for both."""
    _, arrays = tiny
    there, in_c = arrays["presence"][:, 1], arrays | {"states": arrays["states"][:, ::-1]}
    torch.testing.assert_close(poses(arrays)[there], poses(in_c)[there])


def test_only_what_is_declared_is_among_the_inputs(tiny) -> None:
    spec, arrays = tiny
    for declared in ((), ("pose",), ("object_type",)):
        inputs = to_batch(arrays, spec.scenario, declared).inputs
        assert [name for name in ("object_type", "pose") if getattr(inputs, name) is not None] == [*declared]
        assert inputs.confounders is None


def test_twins_look_the_same(tiny) -> None:
    _, arrays = tiny
    for features in (poses(arrays), object_types(arrays)):
        torch.testing.assert_close(features[::2], features[1::2], atol=0, rtol=0)


def test_released_collisions_tell_types_and_poses(tmp_path: Path) -> None:
    tree = CoPhyTree(tmp_path / "CoPhy_224", clips=False)
    along_y = Rotation.from_euler("x", 90, degrees=True).as_quat()
    for name in "0123":
        directory = tree.collision(name, moving="cylinder_down", static="sphere")
        for part in ("ab", "cd"):
            states = np.load(directory / part / "states.npy")
            states[..., 3:7] = np.where(states.any(axis=-1, keepdims=True), along_y, 0)
            np.save(directory / part / "states.npy", states)
    tree.lists("collisionCF", "_normal", **LISTS)
    arrays = load("cophy", "collision", tree.root)
    types, pose = object_types(arrays), poses(arrays)
    for row, name in enumerate("0123"):
        lines = (tree.root / "collisionCF" / name / "ab" / "colors.txt").read_text().splitlines()
        moving, static = (COLLISION_COLORS.index(line.split("color=")[1]) for line in lines)
        assert types[row, moving].tolist() == [0, 0, 1]
        assert types[row, static].tolist() == [0, 1, 0]
        assert not pose[row, static].any()
        torch.testing.assert_close(pose[row, moving], torch.eye(len(POSE))[POSE.index("axis_cos_2")] * -1)


def test_confounders_are_standardised_over_present_objects(tiny) -> None:
    _, arrays = tiny
    raw, presence = confounder_features(arrays), torch.from_numpy(arrays["presence"][:, 0])
    features = standardised(raw, presence, confounder_statistics(raw, presence))
    values, before = features[presence], raw[presence]
    horizontal = [column for pair in HORIZONTAL for column in pair]
    scalars = [column for column in range(len(CONFOUNDERS)) if column not in horizontal]
    varies = (before.std(dim=0) > 0).float()
    torch.testing.assert_close(values.mean(dim=0)[scalars], torch.zeros(len(scalars)), atol=1e-5, rtol=0)
    torch.testing.assert_close(values.std(dim=0)[scalars], varies[scalars], atol=1e-5, rtol=0)
    for pair in HORIZONTAL:  # one scale for both components, so that directions stay what they are
        size = values[:, pair].square().mean().sqrt()
        torch.testing.assert_close(size, before[:, pair].any().float(), atol=1e-5, rtol=0)
    assert not features[~presence].any()


@pytest.mark.parametrize("value", [0.1, 1 / 3, 0.7])
def test_a_constant_is_not_scaled_up_by_its_rounding(value: float) -> None:
    features, presence = torch.full((101, 2, len(CONFOUNDERS)), value), torch.ones(101, 2, dtype=torch.bool)
    statistics = confounder_statistics(features, presence)
    other = standardised(features + 0.9, presence, statistics)
    assert other.abs().max() < 10


def test_a_vector_with_one_constant_component_has_one_scale() -> None:
    features, presence = torch.zeros(101, 2, len(CONFOUNDERS)), torch.ones(101, 2, dtype=torch.bool)
    features[..., HORIZONTAL[0][1]] = torch.linspace(-1, 1, 101)[:, None]
    _, deviation = confounder_statistics(features, presence)
    assert deviation[HORIZONTAL[0][0]] == deviation[HORIZONTAL[0][1]] < 1


@pytest.mark.parametrize(
    ("model", "declared"),
    [
        ({}, ()),
        ({"confounders": "estimated", "object_type": False, "pose": False}, ()),
        ({"confounders": None, "pose": "standing"}, ()),  # a key of a user's model
        ({"confounders": "ground_truth"}, ("confounders",)),
        ({"object_type": True, "pose": True}, ("object_type", "pose")),
    ],
)
def test_a_model_declares_its_inputs_by_its_keys(model: dict, declared: tuple[str, ...]) -> None:
    assert declared_inputs(model) == declared


def test_inputs_that_no_derenderer_estimates_are_named_by_their_keys() -> None:
    assert not_derendered(("confounders",)) == ""
    assert not_derendered(("confounders", "pose")) == "model.pose=true"
    assert not_derendered(("object_type", "pose")) == "model.object_type=true and model.pose=true"
