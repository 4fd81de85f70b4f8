"""Canonical frames: a network in one does not see how an experiment is turned, and predicts in the frame of its inputs."""

from dataclasses import replace
from itertools import product

import pytest
import torch

from cophy.errors import CophyError
from cophy.models.frames import SCENARIOS, canonical_matrices, turn, turn_inputs
from cophy.types import Inputs
from tests.conftest import SCENARIOS as ALL_SCENARIOS
from tests.models.networks import build, present_positions, random_batch

QUARTER, MIRROR = torch.tensor([[0.0, -1.0], [1.0, 0.0]]), torch.tensor([[1.0, 0.0], [0.0, -1.0]])
EIGHTH = torch.tensor([[0.5**0.5, -(0.5**0.5)], [0.5**0.5, 0.5**0.5]])
CHANGES = {"turn": QUARTER, "mirror": MIRROR, "both": MIRROR @ QUARTER, "45°": EIGHTH}


def turned(inputs: Inputs, matrix: torch.Tensor) -> Inputs:
    return turn_inputs(inputs, matrix.expand(len(inputs), 2, 2))


def inputs_of(scenario: str) -> Inputs:
    """Random experiments; those of collisions have two objects, one of which starts to move."""
    inputs = random_batch(4, [2, 2, 2, 2] if scenario == "collision" else [4, 3, 2, 3]).inputs
    return replace(inputs, presence=inputs.observed_presence) if scenario == "collision" else inputs


def test_every_scenario_has_a_frame() -> None:
    assert set(SCENARIOS) == set(ALL_SCENARIOS)


@pytest.mark.parametrize(
    ("scenario", "change"),
    [*product(SCENARIOS, ("turn", "mirror", "both")), ("collision", "45°")],  # no other floor has all rotations
)
def test_turned_experiments_look_equal(scenario: str, change: str) -> None:
    inputs = inputs_of(scenario)
    other = turned(inputs, CHANGES[change])
    seen = [turn_inputs(each, canonical_matrices(each, scenario)) for each in (inputs, other)]
    torch.testing.assert_close(seen[0].observed, seen[1].observed, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(seen[0].initial, seen[1].initial, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(seen[0].pose, seen[1].pose, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("name", ["cophynet_true", "alongside"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_predictions_turn_with_the_experiment(scenario: str, name: str) -> None:
    network, inputs = build(name, canonical_frame=scenario, pose=True), inputs_of(scenario)
    expected = turn(present_positions(network(inputs), inputs), QUARTER.expand(4, 2, 2))
    other = turned(inputs, QUARTER)
    torch.testing.assert_close(present_positions(network(other), other), expected, atol=1e-4, rtol=1e-4)
    plain = build(name)
    moved = turn(present_positions(plain(inputs), inputs), QUARTER.expand(4, 2, 2))
    assert (present_positions(plain(other), other) - moved).abs().max() > 1e-3


def test_the_axes_are_those_of_the_definition() -> None:
    inputs = inputs_of("collision")
    seen = turn_inputs(inputs, canonical_matrices(inputs, "collision"))
    motion = (seen.observed[:, 1] - seen.observed[:, 0]) * inputs.observed_presence[..., None]
    fastest = motion[..., :2].norm(dim=-1).argmax(dim=1)
    heading = motion[torch.arange(4), fastest, :2]
    torch.testing.assert_close(heading[:, 1], torch.zeros(4), atol=1e-5, rtol=0)
    assert (heading[:, 0] > 0).all()
    left = (seen.initial - seen.initial[torch.arange(4), fastest][:, None])[..., 1] * inputs.presence
    assert (left.sum(dim=1) >= 0).all()


def test_a_scenario_without_a_frame_is_named() -> None:
    with pytest.raises(CophyError, match="must be one of collision, balls, blocktower"):
        build("cophynet", canonical_frame="cars")
