"""GNS: its rollout in closed form, and what it knows of walls."""

from dataclasses import replace

import pytest
import torch

from cophy.models import GNS
from cophy.models.gns import NEAR_WALL_M
from cophy.types import Inputs
from tests.models.networks import NUM_FRAMES, build, present_positions, random_batch
from tests.models.test_alongside import UNLIMITED, longest_step

HALF_WIDTH = 100.0  # metres


def gns(factor: float, **arguments: float | None) -> GNS:
    """Build a GNS that accelerates more than an untrained one does, by this factor."""
    network = build("gns", **arguments)
    assert isinstance(network, GNS)
    with torch.no_grad():
        network.decode[-1].weight *= factor
    return network


def inputs_at(*xy: float) -> Inputs:
    """One experiment whose only object is at this place on the floor in C."""
    inputs = random_batch(2, [1]).inputs
    return replace(inputs, initial=torch.tensor([*xy, 0.5]) * inputs.presence[..., None])


def test_a_constant_acceleration_makes_steps_grow_up_to_the_limit() -> None:
    network, inputs = gns(0.0, max_step=0.35), random_batch(4, [4, 3]).inputs
    with torch.no_grad():
        network.decode[-1].bias[0] = 0.1  # metres per frame²
    moved = (network(inputs).position - inputs.initial[:, None]).movedim(1, 2)[inputs.presence]  # object, step, xyz
    expected = torch.tensor([0.1, 0.2, 0.3, 0.35, 0.35, 0.35]).cumsum(dim=0)
    torch.testing.assert_close(moved[..., 0], expected.expand(len(moved), -1), atol=1e-5, rtol=0)
    torch.testing.assert_close(moved[..., 1:], torch.zeros(len(moved), NUM_FRAMES - 1, 2))


def test_no_step_is_longer_than_the_limit() -> None:
    inputs = random_batch(4, [4, 3, 2]).inputs
    assert longest_step(gns(1e4, max_step=UNLIMITED)(inputs).position, inputs) > 10
    assert longest_step(gns(1e4, max_step=0.5)(inputs).position, inputs) <= 0.5 + 1e-4


@pytest.mark.parametrize("arena_half_width", [None, HALF_WIDTH])
def test_places_on_the_floor_are_alike_far_from_walls(arena_half_width: float | None) -> None:
    network, inputs = gns(100.0, arena_half_width=arena_half_width), random_batch(4, [4, 3]).inputs
    shifted = replace(inputs, initial=inputs.initial + torch.tensor([30.0, -50.0, 0.0]) * inputs.presence[..., None])
    moved, expected = (present_positions(network(each), each) - each.initial[:, None] for each in (shifted, inputs))
    assert expected.abs().max() > 0.5
    torch.testing.assert_close(moved, expected, atol=1e-3, rtol=0)


def test_each_of_four_walls_is_noticed_nearby() -> None:
    network = gns(1.0, arena_half_width=HALF_WIDTH)

    def moved(*xy: float) -> torch.Tensor:
        inputs = inputs_at(*xy)
        return present_positions(network(inputs), inputs).detach() - inputs.initial[:, None]

    near, not_near = HALF_WIDTH - 0.5 * NEAR_WALL_M, HALF_WIDTH - 2 * NEAR_WALL_M
    places = [(near, 0.0), (-near, 0.0), (0.0, near), (0.0, -near), (0.0, 0.0)]
    everywhere = [moved(*place) for place in places]
    for number, one in enumerate(everywhere):
        for other in everywhere[:number]:
            assert (one - other).abs().max() > 5e-4
    torch.testing.assert_close(moved(not_near, -not_near), everywhere[-1], atol=1e-4, rtol=0)
