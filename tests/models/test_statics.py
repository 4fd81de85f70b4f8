"""Learned statics against the closed form that generates towers."""

import numpy as np
import torch

from cophy.models.statics import LearnedStatics
from cophy.scenario.statics import joint_margins
from cophy.types import POSE, POSE_ANGLES


def features_of(
    position: torch.Tensor, presence: torch.Tensor, mass: torch.Tensor, tilt: torch.Tensor
) -> dict[str, torch.Tensor]:
    hypotheses = mass.shape[-1]
    features = LearnedStatics(5, hypotheses, 1.0)(position, presence, mass, tilt)
    parts = features.split([2 * hypotheses, 2 * hypotheses, *[hypotheses] * 3], dim=-1)
    return dict(zip(("from_block", "from_support", "margin", "lowest", "above"), parts, strict=True))


def random_towers(count: int, levels: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return towers whose blocks are displaced along x alone, two sets of masses, and two tilts along x."""
    generator = torch.Generator().manual_seed(levels)
    position = torch.zeros(count, levels, 3)
    position[..., 0] = 0.3 * torch.randn(count, levels, generator=generator)
    position[..., 2] = torch.arange(levels) + 0.5
    mass = torch.where(torch.rand(count, levels, 2, generator=generator) < 0.5, 1.0, 10.0)
    tilt = torch.zeros(count, 2, 2)
    tilt[..., 0] = 0.1 * torch.randint(-1, 2, (count, 2), generator=generator)
    return position, mass, tilt


def test_with_true_masses_and_gravity_the_margins_are_those_of_statics() -> None:
    """Along one axis, the distance to the edge of a face does not depend on the other coordinate."""
    for levels in (2, 3, 4):
        position, mass, tilt = random_towers(50, levels)
        found = features_of(position, torch.ones(50, levels, dtype=torch.bool), mass, tilt)["margin"]
        for tower, hypothesis in np.ndindex(50, 2):
            expected = joint_margins(
                position[tower : tower + 1, :, :2].numpy(),
                np.zeros((1, levels)),
                mass[tower, None, :, hypothesis].numpy(),
                tilt[tower, None, hypothesis].numpy(),
            )[0, 0]
            np.testing.assert_allclose(found[tower, :, hypothesis], expected, atol=1e-3)


def test_the_yaw_of_blocks_makes_margins_exact() -> None:
    position, mass, tilt = random_towers(50, 3)
    position[..., :2] = 0.2 * torch.randn(50, 3, 2, generator=torch.Generator().manual_seed(0))
    yaw = torch.linspace(0, 1.5, 150).view(50, 3)
    pose = torch.zeros(50, 3, len(POSE))
    pose[..., POSE_ANGLES[4]] = torch.stack([torch.cos(4 * yaw), torch.sin(4 * yaw)], dim=-1)
    found = LearnedStatics(5, 2, 1.0)(position, torch.ones(50, 3, dtype=torch.bool), mass, tilt, pose)[..., 8:10]
    for tower, hypothesis in np.ndindex(50, 2):
        expected = joint_margins(
            position[tower : tower + 1, :, :2].numpy(),
            yaw[tower : tower + 1].numpy(),
            mass[tower, None, :, hypothesis].numpy(),
            tilt[tower, None, hypothesis].numpy(),
        )[0, 0]
        np.testing.assert_allclose(found[tower, :, hypothesis], expected, atol=1e-5)


def test_a_tower_is_as_weak_as_its_weakest_joint() -> None:
    position, mass, tilt = random_towers(20, 4)
    found = features_of(position, torch.ones(20, 4, dtype=torch.bool), mass, tilt)
    torch.testing.assert_close(found["lowest"], found["margin"].amin(dim=1, keepdim=True).expand_as(found["margin"]))
    torch.testing.assert_close(found["above"][:, -1], found["margin"][:, -1])  # nothing is above the top
    torch.testing.assert_close(found["above"][:, 0], found["lowest"][:, 0])  # all is above the ground


def test_empty_slots_change_nothing_and_blocks_come_in_any_order() -> None:
    position, mass, tilt = random_towers(20, 3)
    alone = torch.cat([*features_of(position, torch.ones(20, 3, dtype=torch.bool), mass, tilt).values()], dim=-1)
    order = [4, 2, 0, 1, 3]  # slots 1 and 3 of the padded towers are empty
    padded = torch.cat([position, torch.full((20, 2, 3), 7.0)], dim=1)[:, order]
    masses = torch.cat([mass, torch.ones(20, 2, 2)], dim=1)[:, order]
    presence = (torch.arange(5) < 3)[order].expand(20, 5)
    found = torch.cat([*features_of(padded, presence, masses, tilt).values()], dim=-1)
    torch.testing.assert_close(found[:, [order.index(slot) for slot in range(3)]], alone)
    assert not found[~presence].any()


def test_masses_and_gravity_are_read_off_the_blocks_that_are_seen() -> None:
    statics, encoded = LearnedStatics(5, 2, 1.0), torch.randn(6, 3, 5)
    seen = torch.tensor([True, True, False]).expand(6, 3)
    mass, tilt = statics.hypotheses(encoded, seen)
    changed = encoded.clone()
    changed[:, 2] += 1  # a block that is not seen tells no tilt
    torch.testing.assert_close(statics.hypotheses(changed, seen)[1], tilt)
    assert mass.shape == (6, 3, 2)
    assert (mass > 0).all()
    assert tilt.abs().max() < 0.3
