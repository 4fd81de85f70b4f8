"""Object types and poses as a network is given them."""

from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from cophy.dataset.features import DeclaredInputs, object_types, poses, to_batch
from cophy.scenario import Shape
from cophy.types import OBJECT_TYPES, POSE
from tests.released.indexing import LISTS, load
from tests.released.trees import COLLISION_COLORS, CoPhyTree

RNG = np.random.default_rng(0)


def pose_of(shape: Shape, rotation: Rotation) -> torch.Tensor:
    """Of one object."""
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
    for declared in (DeclaredInputs(), DeclaredInputs(pose=True), DeclaredInputs(object_type=True)):
        inputs = to_batch(arrays, spec.scenario, declared).inputs
        assert (inputs.pose is not None) == declared.pose
        assert (inputs.object_type is not None) == declared.object_type


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
