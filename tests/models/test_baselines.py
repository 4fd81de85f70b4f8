"""Copy B, copy C, replay of AB, IN and NPE."""

from dataclasses import replace

import pytest
import torch

from cophy.models import CopyB, CopyC, DisplacedCopyB, Replay
from cophy.types import Inputs
from tests.models.networks import build, permute_slots, present_positions, random_batch, with_noise_where_absent

REPLAY = {"diameter": 1.0, "kept_speed": 1.0, "shrinkage": 0.2}
SPEED = 0.5  # metres per frame
STEPS = 6


def impact(offset: float, angle: float = 0.0, ahead: float = 2.0) -> tuple[torch.Tensor, int]:
    """Positions (time, slots, 3) of an elastic impact of equal discs without friction, and the frame of their contact.

    Slot 2 moves at SPEED and touches slot 1, which is `offset` metres to the left of its path, after `ahead` - 1 metres.
    """
    depth = (1 - offset**2) ** 0.5
    along, across = torch.tensor([depth, offset]), torch.tensor([-offset, depth])
    contact = round((ahead - 1) / SPEED)
    before = torch.arange(STEPS + 1).clamp(max=contact)[:, None] * SPEED * torch.tensor([1.0, 0.0])
    after = (torch.arange(STEPS + 1) - contact).clamp(min=0)[:, None] * SPEED
    position = torch.zeros(STEPS + 1, 4, 3)
    position[:, 2, :2] = before - after * offset * across
    position[:, 1, :2] = torch.tensor([ahead - 1 + depth, offset]) + after * depth * along
    position[:, 1:3, 2] = 0.5
    return turned(position, angle), contact


def turned(position: torch.Tensor, angle: float) -> torch.Tensor:
    """Rotate positions about the z axis by an angle in rad."""
    cos, sin = torch.tensor(angle).cos(), torch.tensor(angle).sin()
    x, y, z = position.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=-1)


def collision_inputs(observed: torch.Tensor, initial: torch.Tensor) -> Inputs:
    """One experiment with objects in slots 1 and 2."""
    present = torch.tensor([[False, True, True, False]])
    stable = torch.zeros(1, STEPS, 4, dtype=torch.bool)
    return Inputs(observed[None], present, stable, initial[None], present)


@pytest.fixture
def inputs() -> Inputs:
    """Four objects each; in the second experiment one of them is removed."""
    return random_batch(4, [4, 4]).inputs


def test_copy_c_repeats_c_and_copy_b_repeats_b(inputs: Inputs) -> None:
    torch.testing.assert_close(CopyC()(inputs).position[:, 3], inputs.initial)
    torch.testing.assert_close(CopyB()(inputs).position, inputs.observed[:, 1:])
    assert (CopyC()(inputs).stable_logit > 0).all()
    assert ((CopyB()(inputs).stable_logit > 0) == inputs.observed_stable).all()


def test_copy_b_leaves_an_object_missed_in_ab_where_it_is_in_c(inputs: Inputs) -> None:
    missed = inputs.observed_presence.clone()
    missed[:, 0] = False
    prediction = CopyB()(replace(inputs, observed_presence=missed))
    torch.testing.assert_close(
        prediction.position[:, :, 0], inputs.initial[:, None, 0].expand(-1, inputs.num_steps, -1)
    )
    torch.testing.assert_close(prediction.position[:, :, 1:], inputs.observed[:, 1:, 1:])
    assert ((prediction.stable_logit > 0)[:, :, 0] >= inputs.presence[:, None, 0]).all()
    assert ((prediction.stable_logit > 0)[:, :, 1:] == inputs.observed_stable[:, :, 1:]).all()


def test_displaced_copy_b_shifts_what_the_do_operation_displaces(inputs: Inputs) -> None:
    shift = torch.tensor([0.3, -0.2, 0.0])
    initial = inputs.observed[:, 0] * inputs.presence[..., None]
    initial[0, 1] += shift
    prediction = DisplacedCopyB()(replace(inputs, initial=initial)).position
    expected = inputs.observed[:, 1:].clone()
    expected[0, :, 1] += shift
    present = inputs.presence[:, None, :, None]
    torch.testing.assert_close(prediction * present, expected * present)


@pytest.mark.parametrize("angle", [0.0, 0.5, -2.0])
@pytest.mark.parametrize("offset", [0.0, 0.6, -0.6])
@pytest.mark.parametrize("observed_offset", [0.0, 0.6])
def test_replay_of_an_impact_without_friction_is_exact(observed_offset: float, offset: float, angle: float) -> None:
    """In C the objects touch later than in AB. With an offset, the impact is oblique."""
    (observed, _), (truth, contact) = impact(observed_offset, angle), impact(offset, angle, ahead=2.5)
    assert contact == 3
    prediction = Replay(**REPLAY)(collision_inputs(observed, truth[0])).position[0]
    torch.testing.assert_close(prediction, truth[1:], atol=1e-5, rtol=0)


@pytest.mark.parametrize(("observed_offset", "kept"), [(0.0, 0.5), (0.2, 0.75), (0.6, 0.95)])
def test_replay_weighs_ab_against_the_prior_by_the_angle_of_impact(observed_offset: float, kept: float) -> None:
    """In AB, the moving object keeps its speed across the line of centres; in the prior, it keeps half of it.

    Both have the same weight if the sine of the angle is the shrinkage, 0.2.
    """
    (observed, _), (truth, contact) = impact(observed_offset), impact(0.6, ahead=2.5)
    prediction = Replay(**REPLAY | {"kept_speed": 0.5})(collision_inputs(observed, truth[0])).position[0]
    moved, expected = prediction[:, 2] - truth[contact, 2], truth[1:, 2] - truth[contact, 2]
    torch.testing.assert_close(moved[contact:], kept * expected[contact:], atol=1e-5, rtol=0)
    torch.testing.assert_close(prediction[:, 1], truth[1:, 1], atol=1e-5, rtol=0)


def test_replay_without_an_impact(inputs: Inputs) -> None:
    """Without one in C, the moving object goes straight on; without one in AB, displaced copy B is predicted."""
    hit, miss = impact(0.0)[0], impact(0.0)[0]
    miss[:, 1, :2] = torch.tensor([2.0, 1.5])
    miss[:, 2, 0] = SPEED * torch.arange(STEPS + 1)
    torch.testing.assert_close(Replay(**REPLAY)(collision_inputs(hit, miss[0])).position[0], miss[1:])
    unknown = collision_inputs(miss, hit[0])
    torch.testing.assert_close(Replay(**REPLAY)(unknown).position, DisplacedCopyB()(unknown).position)
    torch.testing.assert_close(Replay(**REPLAY)(inputs).position, DisplacedCopyB()(inputs).position)  # four objects


def test_replay_does_not_depend_on_the_slots_or_on_what_is_absent() -> None:
    inputs = collision_inputs(impact(0.3)[0], impact(-0.2, ahead=2.5)[0][0])
    expected, order = Replay(**REPLAY)(inputs), [2, 0, 3, 1]
    permuted = permute_slots(inputs, order)
    torch.testing.assert_close(Replay(**REPLAY)(permuted).position, expected.position[:, :, order])
    noisy = with_noise_where_absent(inputs)
    torch.testing.assert_close(present_positions(Replay(**REPLAY)(noisy), inputs), present_positions(expected, inputs))


def test_npe_sees_only_objects_within_its_radius(inputs: Inputs) -> None:
    """With blocks 100 m apart, others matter for IN, and might as well be absent for NPE."""
    apart = 100.0 * torch.arange(4.0)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    far = replace(inputs, initial=inputs.initial + apart)
    shifted = replace(far, initial=far.initial + 5 * torch.eye(4)[0][:, None])  # the first slot moves by 5 m
    for name, sees_others in (("npe", False), ("in", True)):
        network = build(name)
        change = (network(shifted).position - network(far).position)[:, :, 1:]
        assert bool(change.abs().max() > 1e-3) == sees_others
