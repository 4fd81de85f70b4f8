"""Contacts against closed forms: discs and squares of 1 m, one step of constant velocity."""

import math

import pytest
import torch

from cophy.models.contacts import Contact, Contacts
from cophy.types import POSE, POSE_ANGLES


def contact_of(offset: list[float], velocity: list[float], pose: torch.Tensor | None = None) -> Contact:
    """Return the contact of two objects, given position and motion of the second relative to the first."""
    position, motion = torch.zeros(1, 2, 3), torch.zeros(1, 2, 3)
    position[0, 1], motion[0, 1] = torch.tensor(offset), torch.tensor(velocity)
    with torch.no_grad():
        return Contacts()(position, motion, pose)


def lying(angle: float, slot: int) -> torch.Tensor:
    """Return the poses of two objects, one of which is a cylinder that lies with its axis at this angle, the other a sphere."""
    pose = torch.zeros(1, 2, len(POSE))
    pose[0, slot, POSE_ANGLES[2]] = torch.tensor([math.cos(2 * angle), math.sin(2 * angle)])
    return pose


def test_head_on_contact() -> None:
    contact = contact_of([3.0, 0, 0], [-4.0, 0, 0])
    torch.testing.assert_close(contact.moment.flatten(), torch.tensor([0.5, 0.5]))
    torch.testing.assert_close(contact.normal[0, 0], torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]]))
    torch.testing.assert_close(contact.approach.flatten(), torch.tensor([-4.0, -4.0]))
    torch.testing.assert_close(contact.gap.flatten(), torch.zeros(2), atol=1e-5, rtol=0)
    assert contact.slip.abs().max() < 1e-5
    assert contact.touches.all()


def test_an_oblique_contact_has_the_normal_of_its_moment() -> None:
    contact = contact_of([3.0, 0.6, 0], [-4.0, 0, 0])  # they touch where they are 0.8 m apart along x
    torch.testing.assert_close(contact.normal[0, 0, 0], torch.tensor([0.8, 0.6, 0]))
    torch.testing.assert_close(contact.moment[0, 0, 0], torch.tensor([2.2 / 4]))
    torch.testing.assert_close(contact.approach[0, 0, 0], torch.tensor([-4 * 0.8]))
    torch.testing.assert_close(contact.slip[0, 0, 0], torch.tensor([-4 + 4 * 0.64, 4 * 0.48, 0]))


@pytest.mark.parametrize("velocity", [[-1.0, 0, 0], [4.0, 0, 0], [-4.0, 4.0, 0], [0.0, 0, 0]])
def test_objects_that_arrive_too_late_or_pass_do_not_touch(velocity: list[float]) -> None:
    contact = contact_of([3.0, 0, 0], velocity)
    assert not contact.touches.any()
    assert (contact.gap > 0).all()
    assert all(torch.isfinite(tensor).all() for tensor in vars(contact).values())


def test_equal_masses_exchange_their_motion_along_the_normal_in_an_elastic_impact() -> None:
    contact, incoming = contact_of([3.0, 0.6, 0], [-4.0, 0, 0]), torch.tensor([-4.0, 0, 0])
    logits = torch.tensor([math.inf, -math.inf, 0]).expand(1, 1, 2, 3)  # elastic, without friction
    first, second = contact.impulse(logits)[0, 0]
    torch.testing.assert_close(first, -4 * 0.8 * torch.tensor([0.8, 0.6, 0]))
    torch.testing.assert_close(first + second, torch.zeros(3), atol=1e-6, rtol=0)  # momentum is conserved
    energy = first.norm() ** 2 + (incoming + second).norm() ** 2
    torch.testing.assert_close(energy, incoming.norm() ** 2)


def test_impulses_of_a_pair_conserve_momentum_and_add_no_energy() -> None:
    contact, incoming = contact_of([3.0, 0.6, 0], [-4.0, 0.5, 1]), torch.tensor([-4.0, 0.5, 1])
    torch.manual_seed(0)
    for logits in 5 * torch.randn(20, 1, 1, 2, 3):
        first, second = contact.impulse(logits)[0, 0]
        mass_ratio = torch.exp(logits[0, 0, 1, 2] - logits[0, 0, 0, 2])  # of the first to the second
        torch.testing.assert_close(mass_ratio * first + second, torch.zeros(3), atol=1e-3, rtol=1e-3)
        before = incoming.norm() ** 2
        after = mass_ratio * first.norm() ** 2 + (incoming + second).norm() ** 2
        assert after <= before * (1 + 1e-5)


def test_changes_are_projected_on_normal_and_slip() -> None:
    contact = contact_of([3.0, 0.6, 0], [-4.0, 0, 0])
    projected = contact.along(torch.tensor([[[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]]]))
    torch.testing.assert_close(projected[0, 0, 0], torch.tensor([1.0, 0.0, 0.0, 1.0]), atol=1e-5, rtol=0)


@pytest.mark.parametrize("slot", [0, 1])
@pytest.mark.parametrize(
    ("angle", "reach"), [(0.0, 1.0), (math.pi / 2, 1.0), (math.pi / 4, 0.5 + 0.5**0.5), (-math.pi / 4, 0.5 + 0.5**0.5)]
)
def test_a_lying_cylinder_is_touched_at_its_side_or_its_corner(angle: float, reach: float, slot: int) -> None:
    contact = contact_of([3.0, 0, 0], [-4.0, 0, 0], lying(angle, slot))
    torch.testing.assert_close(contact.moment.flatten(), torch.full((2,), (3 - reach) / 4), atol=1e-3, rtol=0)
    torch.testing.assert_close(contact.normal[0, 0], torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]]), atol=1e-3, rtol=0)
    assert contact.touches.all()


def test_a_side_that_is_hit_obliquely_has_its_own_normal() -> None:
    """Between discs, the normal depends on where they meet; along a side it does not."""
    contact = contact_of([3.0, 0.4, 0], [-4.0, 0, 0], lying(0.0, 0))
    torch.testing.assert_close(contact.normal[0, 0, 0], torch.tensor([1.0, 0, 0]), atol=1e-3, rtol=0)
    torch.testing.assert_close(contact.moment[0, 0, 0], torch.tensor([0.5]), atol=1e-3, rtol=0)


def test_moments_are_those_of_small_steps() -> None:
    """Random approaches to squares that are turned at random; those that pass do not touch."""
    torch.manual_seed(0)
    count = 500
    offset, velocity = 1.2 + torch.rand(count), 3 * torch.rand(count)
    direction, heading, angle = 6.3 * torch.rand(count), 1.2 * torch.randn(count), 3.2 * torch.rand(count)
    position, motion = torch.zeros(count, 2, 3), torch.zeros(count, 2, 3)
    position[:, 1, :2] = offset[:, None] * torch.stack([direction.cos(), direction.sin()], dim=1)
    towards = direction + math.pi + 0.5 * heading
    motion[:, 1, :2] = velocity[:, None] * torch.stack([towards.cos(), towards.sin()], dim=1)
    pose = torch.zeros(count, 2, len(POSE))
    pose[:, 0, POSE_ANGLES[2]] = torch.stack([(2 * angle).cos(), (2 * angle).sin()], dim=1)
    contact = Contacts()(position, motion, pose)

    moments = torch.linspace(0, 1, 2001)
    path = position[:, 1, None, :2] + moments[:, None] * motion[:, 1, None, :2]
    axis = torch.stack([angle.cos(), angle.sin()], dim=1)
    across = torch.stack([-axis[:, 1], axis[:, 0]], dim=1)
    inside = torch.stack([torch.einsum("nsx,nx->ns", path, each) for each in (axis, across)], dim=-1)
    distance = (inside.abs() - 0.5).clamp(min=0).norm(dim=-1)
    hits = (distance < 0.5).any(dim=1)
    first = moments[(distance < 0.5).float().argmax(dim=1)]
    grazes = (distance.amin(dim=1) - 0.5).abs() < 0.06  # either answer will do
    touches = contact.touches[:, 0, 0, 0] > 0
    assert 0.2 < hits.float().mean() < 0.8
    assert torch.equal(touches[~grazes], hits[~grazes])
    found = contact.moment[:, 0, 0, 0]
    torch.testing.assert_close(found[hits & ~grazes], first[hits & ~grazes], atol=0.002, rtol=0)


def test_both_objects_of_a_pair_see_the_same_contact() -> None:
    contact = contact_of([2.0, 0.7, 0], [-3.0, 0.3, 0], lying(0.4, 1))
    torch.testing.assert_close(contact.moment[0, 0, 0], contact.moment[0, 0, 1])
    torch.testing.assert_close(contact.normal[0, 0, 0], -contact.normal[0, 0, 1])
    torch.testing.assert_close(contact.gap[0, 0, 0], contact.gap[0, 0, 1])


def test_two_of_a_kind_are_discs() -> None:
    """Two lying cylinders, and objects of which none lies; towers have poses, too."""
    plain = contact_of([3.0, 0.6, 0], [-4.0, 0, 0])
    for pose in (torch.zeros(1, 2, len(POSE)), lying(0.3, 0) + lying(0.7, 1)):
        for name, tensor in vars(contact_of([3.0, 0.6, 0], [-4.0, 0, 0], pose)).items():
            torch.testing.assert_close(tensor, getattr(plain, name))


def test_gradients_of_square_contacts_are_finite() -> None:
    """Also of objects that do not move, that overlap, or that graze a side."""
    position = torch.tensor([[[0.0, 0, 0], [x, y, 0]] for x in (0.0, 0.3, 1.0, 3.0) for y in (0.0, 0.5, 1.0)])
    for way in ([0.0, 0, 0], [-4.0, 0, 0], [0.0, -3, 0]):
        motion = torch.zeros_like(position)
        motion[:, 1] = torch.tensor(way)
        position.requires_grad_(), motion.requires_grad_()
        contact = Contacts()(position, motion, lying(0.2, 0).expand(len(position), -1, -1))
        gradients = torch.autograd.grad(sum(each.sum() for each in vars(contact).values()), (position, motion))
        assert all(torch.isfinite(each).all() for each in gradients)
