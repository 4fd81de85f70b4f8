"""Contacts against closed forms: spheres of 1 m, one step of constant motion."""

import math

import pytest
import torch

from cophy.models.alongside import CAUTIOUS, Contact, Contacts


def meet(apart: list[float], moving: list[float]) -> Contact:
    """What the first of two objects is about to meet in the second, and the second in the first."""
    position, motion = torch.zeros(1, 2, 3), torch.zeros(1, 2, 3)
    position[0, 1], motion[0, 1] = torch.tensor(apart), torch.tensor(moving)
    with torch.no_grad():
        return Contacts()(position, motion)


def test_head_on() -> None:
    contact = meet([3.0, 0, 0], [-4.0, 0, 0])
    torch.testing.assert_close(contact.moment.flatten(), torch.tensor([0.5, 0.5]))
    torch.testing.assert_close(contact.normal[0, 0], torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]]))
    torch.testing.assert_close(contact.approach.flatten(), torch.tensor([-4.0, -4.0]))
    torch.testing.assert_close(contact.gap.flatten(), torch.zeros(2), atol=1e-5, rtol=0)
    assert contact.slip.abs().max() < 1e-5
    assert contact.touches.all()


def test_an_oblique_meeting_has_the_normal_of_its_moment() -> None:
    contact = meet([3.0, 0.6, 0], [-4.0, 0, 0])  # they touch where they are 0.8 apart along x
    torch.testing.assert_close(contact.normal[0, 0, 0], torch.tensor([0.8, 0.6, 0]))
    torch.testing.assert_close(contact.moment[0, 0, 0], torch.tensor([2.2 / 4]))
    torch.testing.assert_close(contact.approach[0, 0, 0], torch.tensor([-4 * 0.8]))
    torch.testing.assert_close(contact.slip[0, 0, 0], torch.tensor([-4 + 4 * 0.64, 4 * 0.48, 0]))


@pytest.mark.parametrize("moving", [[-1.0, 0, 0], [4.0, 0, 0], [-4.0, 4.0, 0], [0.0, 0, 0]])
def test_what_comes_too_late_or_passes_does_not_touch(moving: list[float]) -> None:
    contact = meet([3.0, 0, 0], moving)
    assert not contact.touches.any()
    assert (contact.gap > 0).all()
    assert all(torch.isfinite(each).all() for each in vars(contact).values())


def test_equal_masses_that_bounce_without_loss_exchange_what_is_along_the_normal() -> None:
    contact = meet([3.0, 0.6, 0], [-4.0, 0, 0])
    share = torch.tensor([CAUTIOUS, -math.inf]).expand(1, 1, 2, 2)  # half of the most: (1 + e) m / (m + m) with e = 1
    first, second = contact.impulse(share)[0, 0]
    torch.testing.assert_close(first, -4 * 0.8 * torch.tensor([0.8, 0.6, 0]))
    torch.testing.assert_close(first + second, torch.zeros(3), atol=1e-6, rtol=0)  # momentum is kept
    before, after = (
        torch.tensor([-4.0, 0, 0]).norm() ** 2,
        first.norm() ** 2 + (torch.tensor([-4.0, 0, 0]) + second).norm() ** 2,
    )
    torch.testing.assert_close(after, before)  # and so is energy


def test_a_change_is_told_along_the_normal_and_the_slip() -> None:
    contact = meet([3.0, 0.6, 0], [-4.0, 0, 0])
    told = contact.along(torch.tensor([[[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]]]))
    torch.testing.assert_close(told[0, 0, 0], torch.tensor([1.0, 0.0, 0.0, 1.0]), atol=1e-5, rtol=0)
