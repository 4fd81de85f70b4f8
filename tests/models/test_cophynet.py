"""CoPhyNet: gating, ranges of arguments, and whether it can learn."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from cophy.models import CopyC
from cophy.training.losses import position_loss
from cophy.types import Inputs
from tests.models.networks import NUM_FRAMES, build, present_positions, random_batch


@pytest.fixture
def inputs() -> Inputs:
    return random_batch(4, [4, 3, 2, 3]).inputs


def test_static_gating_predicts_stability_once(inputs: Inputs) -> None:
    assert build("static_gating")(inputs).stable_logit.shape[1] == 1
    assert build("cophynet")(inputs).stable_logit.shape[1] == NUM_FRAMES - 1


def test_an_object_that_is_certainly_stable_does_not_move(inputs: Inputs) -> None:
    network = build("cophynet")
    nn.init.zeros_(network.decoder.to_stable_logit.weight)
    nn.init.constant_(network.decoder.to_stable_logit.bias, 50.0)
    position = present_positions(network(inputs), inputs)
    torch.testing.assert_close(position, present_positions(CopyC()(inputs), inputs))


def test_one_batch_overfits() -> None:
    """Objects move in D with the velocities that they have in AB, which C does not show."""
    inputs, targets = vars(random_batch(4, [3] * 8)).values()
    velocity = torch.rand(8, 1, 4, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    path = velocity * torch.arange(NUM_FRAMES)[:, None, None] * inputs.observed_presence[:, None, :, None]
    inputs = replace(inputs, observed=inputs.observed[:, :1] + path)
    targets = replace(targets, position=inputs.initial[:, None] + path[:, 1:])
    network = build("cophynet")
    optimizer = torch.optim.Adam(network.parameters(), lr=0.004)
    for _ in range(60):
        loss = position_loss(network(inputs), targets)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)  # as in training: rollouts occasionally explode
        optimizer.step()
    assert loss < 0.1 * position_loss(CopyC()(inputs), targets)
