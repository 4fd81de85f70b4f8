"""Hypotheses of masses and gravity: their statics against the closed form that generates towers, and what the mixture does with them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from cophy.models.hypotheses import MAX_MARGIN, Towers, describe, find_joints
from cophy.scenario.statics import joint_margins
from cophy.types import POSE, POSE_ANGLES, Inputs
from tests.models.networks import build, present_positions, random_batch


def random_towers(levels: int, *, is_turned: bool, count: int = 50) -> Towers:
    """Return towers from the ground up, and two hypotheses of each."""
    generator = torch.Generator().manual_seed(levels)
    xy = 0.25 * torch.randn(count, levels, 2, generator=generator)
    z = (torch.arange(levels) + 0.5).expand(count, levels)
    yaw = 2 * torch.rand(count, levels, generator=generator)
    mass = torch.where(torch.rand(count, 2, levels, generator=generator) < 0.5, 1.0, 10.0)
    tilt = 0.1 * torch.randint(-1, 2, (count, 2, 2), generator=generator)
    position = torch.cat([xy, z[..., None]], dim=-1)
    if not is_turned:  # along one axis, discs and squares are equal
        position[..., 1], tilt[..., 1] = 0.0, 0.0
    return Towers(position, torch.ones(count, levels, dtype=torch.bool), yaw if is_turned else None, mass, tilt)


@pytest.mark.parametrize("levels", [2, 3, 4])
@pytest.mark.parametrize("is_turned", [True, False])
def test_margins_are_those_of_statics(levels: int, is_turned: bool) -> None:
    towers = random_towers(levels, is_turned=is_turned)
    yaw = torch.zeros(50, levels) if towers.yaw is None else towers.yaw
    found = find_joints(towers).margin
    for tower, hypothesis in np.ndindex(50, 2):
        expected = joint_margins(
            towers.position[tower : tower + 1, :, :2].numpy(),
            yaw[tower : tower + 1].numpy(),
            towers.mass[tower, hypothesis : hypothesis + 1].numpy(),
            towers.tilt[tower, hypothesis : hypothesis + 1].numpy(),
        )[0, 0]
        np.testing.assert_allclose(found[tower, hypothesis], expected, atol=1e-3)


def test_a_load_bears_where_the_lever_says() -> None:
    """Two blocks, the upper one of mass 3 and 0.2 to the right, and gravity that leans to the right by 0.1."""
    position = torch.tensor([[[0.0, 0.0, 0.5], [0.2, 0.0, 1.5]]])
    towers = Towers(
        position, torch.ones(1, 2, dtype=torch.bool), None, torch.tensor([[1.0, 3.0]]), torch.tensor([[0.1, 0.0]])
    )
    joints = find_joints(towers)
    torch.testing.assert_close(joints.load_mass[0, 0], torch.tensor([4.0, 3.0]))
    lower = 0.75 * 0.2 + 0.1 * (0.25 * 0.5 + 0.75 * 1.5)  # mean position, and the height of the centre of mass
    torch.testing.assert_close(joints.bears[0, 0, :, 0], torch.tensor([lower, 0.2 + 0.1 * 0.5]))
    torch.testing.assert_close(joints.margin[0, 0], torch.tensor([0.5 - lower, 0.5 - 0.25]), atol=1e-4, rtol=0)
    torch.testing.assert_close(joints.normal[0, 0], torch.tensor([[1.0, 0.0], [1.0, 0.0]]), atol=1e-4, rtol=0)


def test_empty_slots_change_no_joint_and_blocks_come_in_any_order() -> None:
    towers = random_towers(3, is_turned=True)
    assert towers.yaw is not None
    order = [4, 2, 0, 1, 3]  # slots 1 and 3 of the padded towers are empty

    def padded(values: Tensor, value: float, axis: int) -> Tensor:
        shape = list(values.shape)
        shape[axis] = 2
        filling = values.new_full(shape, value)
        return torch.cat([values, filling], dim=axis).index_select(axis, torch.tensor(order))

    more = Towers(
        padded(towers.position, 7.0, 1),
        padded(towers.presence, False, 1),
        padded(towers.yaw, 0.3, 1),
        padded(towers.mass, 5.0, 2),
        towers.tilt,
    )
    found, (expected, axes), (features, more_axes) = find_joints(more), describe(towers), describe(more)
    real = [order.index(slot) for slot in range(3)]
    torch.testing.assert_close(found.margin[:, :, real], find_joints(towers).margin)
    torch.testing.assert_close(features[:, :, real], expected)
    torch.testing.assert_close(more_axes, axes)
    assert (found.margin[:, :, [i for i in range(5) if i not in real]] == MAX_MARGIN).all()


def turned_by_90_degrees(inputs: Inputs) -> Inputs:
    """Rotate positions; the pose of a block is the same after a quarter turn."""

    def turned(position: Tensor) -> Tensor:
        return torch.stack([-position[..., 1], position[..., 0], position[..., 2]], dim=-1)

    return replace(inputs, observed=turned(inputs.observed), initial=turned(inputs.initial))


@pytest.mark.parametrize("pose", [True, False])
def test_a_quarter_turn_turns_the_prediction(pose: bool) -> None:
    network, inputs = build("hypotheses", pose=pose), random_batch(4, [4, 3, 2, 3]).inputs
    expected = present_positions(network(inputs), inputs)
    found = present_positions(network(turned_by_90_degrees(inputs)), inputs)
    torch.testing.assert_close(found[..., 0], -expected[..., 1], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(
        found[..., 1:], torch.stack([expected[..., 0], expected[..., 2]], dim=-1), atol=1e-4, rtol=1e-4
    )


def test_hypotheses_are_all_combinations_of_two_masses_and_nine_tilts() -> None:
    network = build("hypotheses")
    with torch.no_grad():
        network.log_ratio.fill_(np.log(10))
        network.tilt.fill_(0.1)
    mass, tilt = network.combinations(3)
    assert len({*map(tuple, torch.cat([mass, tilt], dim=1).tolist())}) == 2**3 * 9
    torch.testing.assert_close(mass.amax() / mass.amin(), torch.tensor(10.0))
    assert {*np.round(tilt.flatten().tolist(), 3)} == {-0.1, 0.0, 0.1}


def test_one_batch_overfits() -> None:
    torch.manual_seed(0)
    batch = random_batch(3, [3] * 32)
    inputs, network = batch.inputs, build("hypotheses", pose=False)
    optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
    losses = []
    for _ in range(150):
        optimizer.zero_grad()
        prediction = network(inputs)
        error = (prediction.position - batch.targets.position).square()
        loss = (error * inputs.presence[:, None, :, None]).mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.3 * losses[0]


def test_pose_is_needed_where_it_is_seen() -> None:
    inputs = replace(random_batch(4, [3, 3]).inputs, pose=None)
    with pytest.raises(ValueError, match="pose is not among the inputs"):
        build("hypotheses", pose=True)(inputs)
    assert POSE_ANGLES[4] == [POSE.index("block_cos_4"), POSE.index("block_sin_4")]
