"""Hypotheses of masses and gravity: their statics against the closed form that generates towers, and what the mixture does with them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from cophy.dataset.features import poses
from cophy.models.hypotheses import MAX_MARGIN, NEAR, TowerHypotheses, describe, find_joints, yaw_of
from cophy.scenario import Shape
from cophy.scenario.statics import joint_margins
from cophy.types import Inputs, take
from tests.models.networks import NUM_FRAMES, build, present_positions, random_batch


def random_towers(levels: int, *, is_turned: bool, count: int = 50) -> TowerHypotheses:
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
    return TowerHypotheses(
        position, torch.ones(count, levels, dtype=torch.bool), yaw if is_turned else None, mass, tilt
    )


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
    towers = TowerHypotheses(
        position, torch.ones(1, 2, dtype=torch.bool), None, torch.tensor([[1.0, 3.0]]), torch.tensor([[0.1, 0.0]])
    )
    joints = find_joints(towers)
    torch.testing.assert_close(joints.load_mass[0, 0], torch.tensor([4.0, 3.0]))
    lower = 0.75 * 0.2 + 0.1 * (0.25 * 0.5 + 0.75 * 1.5)  # mean position, and the height of the centre of mass
    torch.testing.assert_close(joints.load_point[0, 0, :, 0], torch.tensor([lower, 0.2 + 0.1 * 0.5]))
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

    more = TowerHypotheses(
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


def test_features_turn_with_the_tower() -> None:
    """Any rotation of positions, yaws and tilts leaves the features as they are and turns their frame."""
    towers, angle = random_towers(4, is_turned=True), torch.tensor(0.7)
    matrix = torch.stack([torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])])
    assert towers.yaw is not None
    turned = towers._replace(
        position=torch.cat([towers.position[..., :2] @ matrix.T, towers.position[..., 2:]], dim=-1),
        yaw=towers.yaw + angle,
        tilt=towers.tilt @ matrix.T,
    )
    (features, axes), (found, found_axes) = describe(towers), describe(turned)
    torch.testing.assert_close(found, features, atol=1e-4, rtol=0)
    torch.testing.assert_close(found_axes, axes @ matrix.T, atol=1e-4, rtol=0)


def test_a_load_topples_by_torque_over_inertia() -> None:
    """Blocks of masses 1 and 10 above each other, both 0.55 to the right of the block below, whose edge is at 0.5."""
    position = torch.tensor([[[0.0, 0.0, 0.5], [0.55, 0.0, 1.5], [0.55, 0.0, 2.5]]])
    towers = TowerHypotheses(
        position,
        torch.ones(1, 3, dtype=torch.bool),
        torch.zeros(1, 3),
        torch.tensor([[1.0, 1.0, 10.0]]),
        torch.zeros(1, 2),
    )
    torque = 11 * 0.05
    inertia = sum(mass * (0.05**2 + (0.5 + level) ** 2 + 1 / 6) for level, mass in enumerate((1, 10)))
    rate, acceleration = describe(towers)[0][0, 0, 0, 12:14]
    assert rate.item() == pytest.approx(11 / inertia, rel=1e-4)
    assert acceleration.item() == pytest.approx(torque / inertia / NEAR, rel=1e-4)


def test_margins_above_and_below_are_told_apart() -> None:
    """Discs in a row along x: from the ground up, the margins are 0.13, -0.05 and 0.4."""
    x = torch.tensor([0.0, 0.5, 0.6])
    position = torch.stack([x, torch.zeros(3), torch.arange(3) + 0.5], dim=-1)[None]
    towers = TowerHypotheses(position, torch.ones(1, 3, dtype=torch.bool), None, torch.ones(1, 3), torch.zeros(1, 2))
    margin = find_joints(towers).margin[0, 0]
    torch.testing.assert_close(margin, torch.tensor([0.5 - 1.1 / 3, -0.05, 0.4]), atol=1e-4, rtol=0)
    own, smallest, second, above, below = describe(towers)[0][0, 0, :, 16:21].T
    torch.testing.assert_close(own, margin)
    torch.testing.assert_close(smallest, margin.min().expand(3))
    torch.testing.assert_close(second, margin.sort().values[1].expand(3))
    torch.testing.assert_close(above, torch.stack([margin[1:].min(), margin[2], torch.tensor(MAX_MARGIN)]))
    torch.testing.assert_close(below, torch.stack([torch.tensor(MAX_MARGIN), margin[0], margin[:2].min()]))


def test_yaw_is_that_of_the_states() -> None:
    yaw = np.array([0.3, -0.6, 0.3 + np.pi / 2])
    states = np.zeros((1, 2, 1, 3, 13))
    states[..., 5:7] = np.stack([np.sin(yaw / 2), np.cos(yaw / 2)], axis=-1)
    pose = poses({"states": states, "shape": np.full((1, 3), Shape.BOX)})
    torch.testing.assert_close(yaw_of(pose), torch.tensor([[0.3, -0.6, 0.3]]), atol=1e-5, rtol=0)


def test_twice_the_block_and_all_positions_is_twice_the_prediction() -> None:
    inputs = random_batch(4, [4, 3, 2, 3]).inputs
    doubled = replace(inputs, observed=2 * inputs.observed, initial=2 * inputs.initial)
    found = present_positions(build("hypotheses", block_size=2.0)(doubled), inputs)
    torch.testing.assert_close(found, 2 * present_positions(build("hypotheses")(inputs), inputs), atol=1e-4, rtol=1e-4)


class Residual(torch.nn.Module):
    """Evidence by hand: minus the squared residual, the last part of the features."""

    def forward(self, features: Tensor) -> Tensor:
        return -features[..., -3 * (NUM_FRAMES - 1) :].square().sum(dim=-1, keepdim=True)


def test_the_hypothesis_that_explains_ab_has_the_largest_weight() -> None:
    network, inputs = build("hypotheses"), random_batch(3, [3, 3]).inputs
    network.evidence = Residual()
    presence = inputs.observed_presence
    still = replace(inputs, initial=inputs.observed[:, 0], presence=presence)
    outcomes, _ = network.outcomes(still)
    for hypothesis in (0, 17, 71):
        ab = torch.cat([still.initial[:, None], outcomes[:, hypothesis]], dim=1)
        assert (network.weigh(replace(still, observed=ab)).argmax(dim=1) == hypothesis).all()


@pytest.mark.parametrize("logit", [20.0, -20.0])
def test_stability_is_that_of_the_outcomes(logit: float) -> None:
    network, inputs = build("hypotheses"), random_batch(4, [4, 3]).inputs
    with torch.no_grad():
        network.outcome.bias.view(-1, 4)[:, 3] = logit
    stable = network(inputs).stable_logit
    assert (stable * logit > 0)[inputs.presence[:, None].expand(stable.shape)].all()


def test_with_poses_an_experiment_does_not_depend_on_its_batch() -> None:
    network, inputs = build("hypotheses", pose=True), random_batch(4, [4, 3, 2, 3]).inputs
    alone = take(inputs, slice(2, 3))
    expected = present_positions(network(inputs), inputs)[2:3]
    torch.testing.assert_close(present_positions(network(alone), alone), expected, atol=1e-5, rtol=1e-4)


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
