"""Alongside: contacts against closed forms (spheres of 1 m, one step of constant velocity), and limits of rollouts."""

import math
from dataclasses import replace

import pytest
import torch

from cophy.models.alongside import MAX_HEIGHT_M, STEP_DIMS, Contact, Contacts, EgoFeatures
from cophy.models.layers import Appearance
from cophy.types import Inputs
from tests.models.networks import build, random_batch

UNLIMITED = 1e6  # metres


def contact_of(offset: list[float], velocity: list[float]) -> Contact:
    """Return the contact of two objects, given position and motion of the second relative to the first."""
    position, motion = torch.zeros(1, 2, 3), torch.zeros(1, 2, 3)
    position[0, 1], motion[0, 1] = torch.tensor(offset), torch.tensor(velocity)
    with torch.no_grad():
        return Contacts()(position, motion)


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


def test_steps_are_limited() -> None:
    """In training, too: without a limit, one of four trainings on balls diverged."""
    limited, free = build("alongside", max_step=0.5), build("alongside", max_step=UNLIMITED)
    inputs = random_batch(4, [4, 3, 2]).inputs
    far = replace(inputs, observed=100 * inputs.observed)
    assert longest_step(free(far).position, inputs) > 10
    assert longest_step(limited(far).position, inputs) <= 0.5 + 1e-4


def test_the_limit_applies_to_displacements_and_not_to_the_velocity() -> None:
    """The velocity may exceed any step: clipping it cost a trained network half as much error again."""
    network, unlimited = build("alongside"), build("alongside", max_step=UNLIMITED)
    inputs = random_batch(4, [4, 3, 2]).inputs
    slow = replace(inputs, observed=inputs.observed[:, :1] + 0.01 * inputs.observed)
    with torch.no_grad():
        _, c_next, mixture, mixture_next, *_ = network.to_step[-1].bias.split(STEP_DIMS)
        mixture.fill_(50.0)  # every step is that of AB, so it is short
        mixture_next.fill_(-50.0)
        c_next.fill_(5.0)
    unlimited.load_state_dict(network.state_dict())
    free, limited = unlimited(slow), network(slow)
    assert longest_step(free.position, slow) < 3.2
    torch.testing.assert_close(limited.stable_logit, free.stable_logit)
    torch.testing.assert_close(limited.position, free.position)


def test_heights_are_clipped() -> None:
    """So a fourth block is no higher than the blocks of a training set with three."""
    ego, inputs = EgoFeatures(None, Appearance(object_type=False, pose=False)), random_batch(1, [3]).inputs
    heights = torch.tensor([0.5, MAX_HEIGHT_M, 3.5])
    position = torch.stack([torch.zeros(3), torch.ones(3), heights], dim=-1)[None]
    features = ego.compute(position, torch.zeros_like(position), torch.tensor(1.0), inputs)
    torch.testing.assert_close(features[0, :, 0], torch.tensor([0.5, MAX_HEIGHT_M, MAX_HEIGHT_M]))


def longest_step(position: torch.Tensor, inputs: Inputs) -> float:
    """Return the longest displacement of a present object in one step, metres."""
    path = torch.cat([inputs.initial[:, None], position.detach()], dim=1)
    return float(((path[:, 1:] - path[:, :-1]).norm(dim=-1) * inputs.presence[:, None]).max())
