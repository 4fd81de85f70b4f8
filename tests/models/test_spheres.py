"""Idealised physics of balls against closed forms and conservation laws, and its fit to experiments that follow it."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from cophy.models import FittedSpheres
from cophy.models.spheres import ROLL, Arena, Spheres, at_start
from cophy.types import Inputs
from tests.models.networks import with_noise_where_absent

ARGUMENTS: dict[str, Any] = {
    **{"diameter": 1.0, "arena_half_width": 4.0, "gravity_z": -10.0, "frame_rate_hz": 5.0, "mass": [1.0, 10.0]},
    **{
        "friction": [0.5, 1.0],
        "restitution": [1.0],
        "impacts": 4,
        "hypotheses": 16,
        "followers": 8,
        "draws": 200,
        "error": 0.05,
    },
}
FEW = {"draws": 20}  # where the quality of the fit does not matter
ARENA = Arena(half_width=4.0, radius=0.5, gravity=0.4, parts=4)
STEPS = 14


def spheres(x: list[list[float]], velocity: list[list[float]], mass: list[float], friction: list[float]) -> Spheres:
    position, motion, masses, frictions = (
        torch.tensor([each], dtype=torch.float64) for each in (x, velocity, mass, friction)
    )
    return Spheres(position, motion, masses, frictions, torch.ones_like(masses, dtype=torch.bool))


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_motion_follows_closed_forms(parts: int) -> None:
    def rolled_out(x: list[float], speed: list[float], mass: list[float], friction: float) -> Tensor:
        flat = ([[each, 0.0] for each in values] for values in (x, speed))
        positions = replace(ARENA, parts=parts).roll_out(spheres(*flat, mass, [friction] * len(x)), 4)
        assert positions.shape == (1, 4, len(x), 2)
        torch.testing.assert_close(positions[..., 1], torch.zeros(1, 4, len(x), dtype=torch.float64))
        return positions[0, :, :, 0]

    t = torch.arange(1, 5, dtype=torch.float64)
    sliding = t.clamp(max=0.7 * 2 / 7 / (0.4 * 0.5))  # until it rolls with 5/7 of its speed
    expected = -3 + 0.7 * sliding - 0.4 * 0.5 * sliding**2 / 2 + 5 / 7 * 0.7 * (t - sliding)
    torch.testing.assert_close(rolled_out([-3.0], [0.7], [1.0], 0.5)[:, 0], expected)
    hit = rolled_out([-2.0, 0.0], [0.8, 0.0], [1.0, 10.0], 0.0)  # touch after 1.25 frames, elastic
    close = {"atol": 1e-6, "rtol": 0.0}
    torch.testing.assert_close(hit[0], torch.tensor([-1.2, 0.0], dtype=torch.float64), **close)
    torch.testing.assert_close(hit[1:, 0], -1 - 0.8 * 9 / 11 * (t[1:] - 1.25), **close)
    torch.testing.assert_close(hit[1:, 1], 0.8 * 2 / 11 * (t[1:] - 1.25), **close)
    wall = rolled_out([3.0], [0.8], [1.0], 0.0)[:, 0]
    torch.testing.assert_close(wall, 3.5 - (0.8 * t - 0.5).abs())


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
def test_an_oblique_impact_keeps_momentum_and_makes_no_energy(friction: float) -> None:
    """Without gravity, the floor does nothing; heights do not change, as balls do not hop here."""
    balls = spheres([[-1.0, 0.3], [0.2, 0.0]], [[0.8, 0.0], [-0.1, 0.2]], [1.0, 10.0], [friction] * 2)
    before = at_start(balls)._replace(rolling=0.5 * balls.velocity)
    after = replace(ARENA, gravity=0.0).step(before, balls)
    assert (after.velocity - before.velocity).abs().max() > 0.1
    mass = balls.mass[..., None]
    torch.testing.assert_close((mass * after.velocity).sum(1), (mass * before.velocity).sum(1))

    def energy(velocity: Tensor, rolling: Tensor, spin: Tensor) -> Tensor:
        turning = rolling.square().sum(-1) + spin.square()
        return (balls.mass * (velocity.square().sum(-1) + turning / ROLL)).sum() / 2

    change = energy(*after[1:]) - energy(*before[1:])
    if friction == 0:
        torch.testing.assert_close(change, torch.zeros_like(change))
    else:
        assert change < -1e-4


def experiment(mass: list[float], friction: list[float]) -> tuple[Inputs, Tensor]:
    """AB, in which two balls meet twice and a third is hit, and the D that follows from C."""
    x = [[-2.0, 0.1], [0.5, 0.0], [2.0, 1.2]]
    velocity = [[0.9, 0.0], [-0.3, 0.05], [-0.1, -0.2]]
    ab = spheres(x, velocity, mass, friction)
    cd = replace(ab, position=ab.position + torch.tensor([[0.0, 0.0], [0.3, -0.5], [0.0, 0.0]]))
    observed, outcome = (
        torch.cat([balls.position[:, None], ARENA.roll_out(balls, STEPS)], dim=1).float() for balls in (ab, cd)
    )
    observed, outcome = (
        torch.nn.functional.pad(torch.cat([each, torch.full_like(each[..., :1], 0.5)], dim=-1), (0, 0, 0, 1))
        for each in (observed, outcome)
    )
    presence = torch.tensor([[True, True, True, False]])
    return Inputs(observed, presence, torch.zeros(1, STEPS, 4, dtype=torch.bool), outcome[:, 0], presence), outcome[
        :, 1:
    ]


def error(model: FittedSpheres, inputs: Inputs, outcome: Tensor) -> float:
    return float((model(inputs).position - outcome)[:, :, :3, :2].square().mean())


@pytest.mark.parametrize("mass", [[1.0, 10.0, 1.0], [10.0, 1.0, 10.0]])
def test_experiments_that_follow_the_physics_are_predicted(mass: list[float]) -> None:
    inputs, outcome = experiment(mass, [0.5, 1.0, 0.5])
    assert float((outcome - inputs.initial[:, None])[:, :, :3, :2].square().mean()) > 1
    assert error(FittedSpheres(**ARGUMENTS | {"hypotheses": 64}), inputs, outcome) < 0.01  # all combinations
    assert error(FittedSpheres(**ARGUMENTS | {"mass": [3.0]}), inputs, outcome) > 0.02  # so masses were found
    assert error(FittedSpheres(**ARGUMENTS | {"hypotheses": 24}), inputs, outcome) < 0.02  # drawn, then improved


def test_a_prediction_depends_on_nothing_else() -> None:
    inputs, _ = experiment([1.0, 10.0, 1.0], [0.5, 1.0, 0.5])
    model = FittedSpheres(**ARGUMENTS | FEW)
    expected = model(inputs).position
    noisy = with_noise_where_absent(inputs)
    torch.testing.assert_close(model(noisy).position[:, :, :3], expected[:, :, :3], rtol=0, atol=0)
    pair = {name: torch.cat([value, value.flip(0)]) for name, value in vars(inputs).items() if value is not None}
    torch.testing.assert_close(model(Inputs(**pair)).position[1:], expected, rtol=0, atol=0)


def test_a_removed_ball_touches_nothing_and_one_missed_in_ab_stays() -> None:
    inputs, _ = experiment([1.0, 10.0, 1.0], [0.5, 1.0, 0.5])
    model, gone = FittedSpheres(**ARGUMENTS | FEW), torch.tensor([[True, False, True, False]])
    prediction = model(replace(inputs, presence=gone)).position
    alone = model(replace(inputs, presence=gone, initial=inputs.initial + 50 * ~gone[..., None])).position
    torch.testing.assert_close(prediction[:, :, gone[0]], alone[:, :, gone[0]], rtol=0, atol=0)
    missed = model(replace(inputs, observed_presence=gone)).position
    torch.testing.assert_close(missed[:, :, 1], inputs.initial[:, None, 1].expand_as(missed[:, :, 1]))
    nothing = torch.zeros_like(gone)
    assert model(replace(inputs, presence=nothing, observed_presence=nothing)).position.shape == (1, STEPS, 4, 3)
