"""Alongside: limits of rollouts."""

from dataclasses import replace

import torch

from cophy.models.alongside import MAX_HEIGHT_M, STEP_DIMS, EgoFeatures
from cophy.models.layers import Appearance
from cophy.types import Inputs
from tests.models.networks import build, random_batch

UNLIMITED = 1e6  # metres


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


def test_a_step_counts_beyond_a_wall_from_where_the_object_touches_it() -> None:
    """Walls are 2 m from the origin, and a centre touches them half the reach before. Mirrored objects have mirrored features."""
    ego, inputs = EgoFeatures(2.0, Appearance(object_type=False, pose=False)), random_batch(1, [2]).inputs
    position, motion = torch.tensor([1.4, -1.4, 0.5]), torch.tensor([0.3, -0.7, 0.0])
    mirror = torch.tensor([-1.0, -1.0, 1.0])
    both = (torch.stack([each, mirror * each])[None] for each in (position, motion))
    features = ego.compute(*both, torch.tensor(0.8), inputs)[0, :, 4:]
    assert ego.width == 4 + features.shape[-1]
    expected = torch.tensor([0.7, -0.7, 0.1, -0.5])
    torch.testing.assert_close(features, torch.stack([expected, -expected]))
    still = ego.compute(position[None, None], torch.zeros(1, 1, 3), torch.tensor(0.8), inputs)[0, 0, 4:]
    torch.testing.assert_close(still, torch.tensor([0.7, -0.7, 0.0, 0.0]))


def longest_step(position: torch.Tensor, inputs: Inputs) -> float:
    """Return the longest displacement of a present object in one step, metres."""
    path = torch.cat([inputs.initial[:, None], position.detach()], dim=1)
    return float(((path[:, 1:] - path[:, :-1]).norm(dim=-1) * inputs.presence[:, None]).max())
