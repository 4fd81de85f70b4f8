"""What keeps rollouts of `alongside` from running away."""

from dataclasses import replace

import torch

from cophy.models.alongside import HIGH, PARTS, Own
from cophy.models.layers import Appearance
from cophy.types import Inputs
from tests.models.networks import build, random_batch


def test_objects_go_nowhere_in_leaps_once_it_is_trained() -> None:
    network, inputs = build("alongside", "model.max_step=0.5"), random_batch(4, [4, 3, 2]).inputs
    far = replace(inputs, observed=100 * inputs.observed)
    assert longest_step(network.train()(far).position, inputs) > 10
    assert longest_step(network.eval()(far).position, inputs) <= 0.5 + 1e-4


def test_a_motion_that_no_object_makes_is_left_as_it_is() -> None:
    """The state v may be longer than any step: cutting it had cost a trained network half as much error again."""
    network, inputs = build("alongside", "model.max_step=3.2"), random_batch(4, [4, 3, 2]).inputs
    slow = replace(inputs, observed=inputs.observed[:, :1] + 0.01 * inputs.observed)
    with torch.no_grad():
        _, turn, mixture, next_mixture, *_ = network.to_step[-1].bias.split(PARTS)
        mixture.fill_(50.0)  # every step is AB's, so that it is short
        next_mixture.fill_(-50.0)
        turn.fill_(5.0)
    free, limited = network.train()(slow), network.eval()(slow)
    assert longest_step(free.position, slow) < 3.2
    torch.testing.assert_close(limited.stable_logit, free.stable_logit)
    torch.testing.assert_close(limited.position, free.position)


def test_heights_above_the_limit_count_as_the_limit() -> None:
    """So a fourth block is no higher than what a training on three blocks has shown."""
    own, inputs = Own(None, Appearance(object_type=False, pose=False)), random_batch(1, [3]).inputs
    heights = torch.tensor([0.5, HIGH, 3.5])
    position = torch.stack([torch.zeros(3), torch.ones(3), heights], dim=-1)[None]
    seen = own.of(position, torch.zeros_like(position), torch.tensor(1.0), inputs)
    torch.testing.assert_close(seen[0, :, 0], torch.tensor([0.5, HIGH, HIGH]))


def longest_step(position: torch.Tensor, inputs: Inputs) -> float:
    """Metres, of objects that are there."""
    path = torch.cat([inputs.initial[:, None], position.detach()], dim=1)
    return float(((path[:, 1:] - path[:, :-1]).norm(dim=-1) * inputs.presence[:, None]).max())
