"""Metrics in training and losses against values worked out by hand."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from cophy.errors import CophyError
from cophy.training.losses import confounder_loss, position_loss, stability_loss, stability_target
from cophy.training.metrics import mean_squared_error, own_measures, standing_confusion
from cophy.types import Prediction, Targets
from tests.models.networks import random_batch

INITIAL = torch.tensor([[[0.0, 0.0, 1.5], [0.0, 0.0, 0.5]], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]])


def targets() -> Targets:
    """Two experiments, T = 3 frames, K = 2 slots: two objects, and one object beside an empty slot."""
    presence = torch.tensor([[True, True], [False, True]])
    return Targets(
        position=torch.zeros(2, 2, 2, 3),
        stable=torch.tensor([[[1, 0], [1, 1]], [[0, 1], [0, 0]]], dtype=torch.bool),
        presence=presence,
        initial=INITIAL,
        observed_presence=presence,
        confounder_class=torch.tensor([[[0, 0], [1, 1]], [[9, 9], [1, 0]]]),
        pair=torch.zeros(2, dtype=torch.long),
        cell=torch.tensor([2, 0]),
    )


def prediction() -> Prediction:
    position = torch.zeros(2, 2, 2, 3)
    position[0, 0, 0] = torch.tensor([3.0, 0.0, 0.0])  # first experiment, first step, first object
    position[0, 1, 1] = torch.tensor([0.0, 3.0, 4.0])  # last step, second object
    position[1, 1, 1] = torch.tensor([0.0, 0.0, 6.0])  # second experiment
    position[1, :, 0] = 1000.0  # empty slot
    return Prediction(position, torch.tensor([[[9.0, 9.0], [-9.0, 9.0]], [[-9.0, 9.0], [9.0, 9.0]]]))


@pytest.mark.parametrize(
    ("dims", "first", "second"), [(3, (9 / 3 + 25 / 3) / 4, (36 / 3) / 2), (2, (9 / 2 + 9 / 2) / 4, 0.0)]
)
def test_the_mse_in_training_is_over_coordinates_objects_and_steps(dims: int, first: float, second: float) -> None:
    assert mean_squared_error(dims)(prediction(), targets()).tolist() == pytest.approx([first, second])


def test_confounder_loss_is_over_the_objects_of_ab() -> None:
    mass = torch.tensor([[[9.0, -9.0], [9.0, -9.0]], [[0.0, 0.0], [-9.0, 9.0]]])  # right, wrong by 18, -, right
    friction = torch.zeros(2, 2, 2)  # undecided: log 2
    expected = 18 / 3 + torch.log(torch.tensor(2.0))
    torch.testing.assert_close(
        confounder_loss([mass, friction], replace(targets(), confounder_class=targets().confounder_class.clamp(max=1))),
        expected,
        atol=1e-4,
        rtol=0,
    )


def test_losses_ignore_empty_slots() -> None:
    assert position_loss(prediction(), targets()) == pytest.approx((9 / 3 + 25 / 3 + 36 / 3) / 6)
    wrong = torch.tensor([3 * 9.0]) / 6  # three confident mistakes of six
    torch.testing.assert_close(stability_loss(prediction().stable_logit, targets()), wrong[0], atol=1e-3, rtol=0)
    empty = ~targets().presence[:, None, :, None]
    nonsense = replace(prediction(), position=prediction().position.masked_fill(empty, torch.nan))
    assert position_loss(nonsense, targets()) == position_loss(prediction(), targets())


@pytest.mark.parametrize("reduce", [lambda values: values, lambda values: values.mean(dim=-1)])
def test_a_loss_of_the_user_gets_present_objects_alone(reduce: Callable[[Tensor], Tensor]) -> None:
    """Whatever the empty slots hold, neither its value nor its gradient depends on them."""
    empty = ~targets().presence[:, None, :, None]
    position = prediction().position.masked_fill(empty, torch.nan).requires_grad_()

    def root(predicted: Tensor, target: Tensor) -> Tensor:
        return reduce((predicted - target).square().sqrt())  # with an infinite gradient at 0

    loss = position_loss(replace(prediction(), position=position), targets(), root)
    expected = (prediction().position - targets().position).abs().mean(dim=-1)
    assert loss.item() == pytest.approx(expected[targets().presence[:, None].expand_as(expected)].mean().item())
    loss.backward()
    assert (position.grad[empty.expand_as(position)] == 0).all()


def test_a_loss_of_the_user_may_leave_steps_out() -> None:
    error = prediction().position - targets().position
    last = position_loss(prediction(), targets(), lambda predicted, target: (predicted - target)[:, 1:].square())
    assert last.item() == pytest.approx(error[:, 1][targets().presence].square().mean().item())


@pytest.mark.parametrize("wrong", [torch.Tensor.mean, torch.Tensor.tolist, lambda values: values[0]])
def test_a_loss_of_another_shape_is_refused(wrong: Callable[[Tensor], Any]) -> None:
    with pytest.raises(CophyError, match=r"training\.loss returns .*, not values of steps for each coordinate"):
        position_loss(prediction(), targets(), lambda predicted, target: wrong(predicted - target))


def last_height(prediction: Prediction, targets: Targets, *, sign: int = 1) -> Tensor:
    """A metric of the user: the sum of predicted heights at the last step."""
    return sign * prediction.position[:, -1, :, 2].sum(dim=1)


OWN = {"_target_": f"{__name__}.last_height"}


def test_a_metric_of_the_user_gets_empty_slots_as_zeros() -> None:
    measure = own_measures({"height": OWN | {"sign": -1}}, ())["height"]
    empty = ~targets().presence[:, None, :, None]
    nonsense = replace(prediction(), position=prediction().position.masked_fill(empty, torch.nan))
    expected = -(prediction().position * ~empty)[:, -1, :, 2].sum(dim=1)
    torch.testing.assert_close(measure(nonsense, targets()), expected.double())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda prediction, targets: prediction.position.mean(), r"returns shape \(\), not one value for each of 2"),
        (lambda prediction, targets: [1.0, 2.0], r"returns list, not one value"),
        (lambda prediction, targets: np.array([1.0, np.nan]), r"is not finite in 1 of 2 experiments"),
    ],
)
def test_a_metric_of_another_kind_is_refused(wrong: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "last_height", wrong)
    with pytest.raises(CophyError, match=rf"metrics\.height {message}"):
        own_measures({"height": OWN}, ())["height"](prediction(), targets())


@pytest.mark.parametrize("name", ["mse", "mse_both_stand", "position_loss", "pixel_error", "probe_accuracy"])
def test_a_name_of_another_metric_is_refused(name: str) -> None:
    with pytest.raises(CophyError, match=rf"metrics\.{name}: there is a metric or loss of this name"):
        own_measures({name: OWN}, ("mse_both_stand",))


def test_one_logit_per_sequence_predicts_being_always_stable() -> None:
    assert stability_target(torch.zeros(2, 1, 2), targets()).tolist() == [[[True, False]], [[False, False]]]


def test_a_tower_stands_if_all_its_objects_do() -> None:
    targets = random_batch(4, [2, 2, 2, 2], num_frames=3).targets
    stands = torch.tensor([True, True, False, False])
    targets.stable[:] = stands[:, None, None]
    logit = torch.where(targets.presence[:, None], 1.0, -1.0).repeat(1, 2, 1)  # what is not there does not count
    slot = targets.presence[1].int().argmax()
    logit[1, 0, slot] = logit[2, 0, targets.presence[2].int().argmax()] = -1.0
    assert standing_confusion(Prediction(targets.position, logit), targets).tolist() == [[1, 1], [1, 1]]
