"""Metrics against values worked out by hand."""

from dataclasses import replace

import pytest
import torch

from cophy.scenario import Camera, Task
from cophy.training.losses import confounder_loss, position_loss, stability_loss, stability_target
from cophy.training.metrics import collection, mean_squared_error, pixel_measures, position_measures, stability_measures
from cophy.types import Prediction, Targets, take

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


def position_metrics(dims: int):
    return collection(position_measures(Task(dims, stable_speed=0.1, by_height=False, splits=[])), prefix="")


def stability_metrics():
    return collection(stability_measures(), prefix="")


def computed(metrics) -> dict[str, float]:
    metrics.update(prediction(), targets())
    return {name: float(value) for name, value in metrics.compute().items()}


def test_mse_in_three_dimensions() -> None:
    first = (9 / 3 + 25 / 3) / 4  # two objects, two steps
    second = (36 / 3) / 2  # one object, two steps
    assert computed(position_metrics(3))["mse"] == pytest.approx((first + second) / 2)


def test_mse_in_two_dimensions_ignores_height() -> None:
    assert computed(position_metrics(2))["mse"] == pytest.approx((9 / 2 + 9 / 2) / 4 / 2)


def test_final_position_error_is_the_last_step() -> None:
    assert computed(position_metrics(3))["final_position_error"] == pytest.approx((5.0 / 2 + 6.0) / 2)


def test_stability_accuracy_and_its_base_rate() -> None:
    values = computed(stability_metrics())
    assert values["stability_accuracy"] == pytest.approx((2 / 4 + 1 / 2) / 2)
    assert values["stability_base_rate"] == pytest.approx((3 / 4 + 1 / 2) / 2)


def test_whole_sequence_stability_asks_for_every_step() -> None:
    """First experiment: said to move / to stay, truly stays / moves: none right. Second: both say it moves."""
    stays = replace(prediction(), stable_logit=torch.tensor([[[9.0, 9.0], [-9.0, 9.0]], [[9.0, 9.0], [9.0, -9.0]]]))
    values = [metric.measure(stays, targets()) for metric in stability_metrics().values()]
    names = list(stability_metrics())
    assert values[names.index("sequence_stability_accuracy")].tolist() == [0.0, 1.0]


def test_pixel_error_of_each_object_by_its_height_in_c() -> None:
    """A camera 10 m away that sees 90 degrees: one metre at the target's depth is 22.4 of 448 pixels."""
    camera = Camera(eye=[0.0, -10.0, 0.0], target=[0.0, 0.0, 0.0], field_of_view_deg=90.0)
    measures = pixel_measures(Task(3, 0.1, by_height=True, splits=[]), camera, num_objects=2)
    position = torch.zeros(2, 2, 2, 3)
    position[0, -1, 0], position[0, -1, 1] = torch.tensor([1.0, 0, 0]), torch.tensor([0, 0, -2.0])
    position[1, -1, 1] = torch.tensor([0.0, 10.0, 3.0])  # twice as far away
    values = {name: measure(Prediction(position), targets()) for name, measure in measures.items()}
    assert values["pixel_error"].tolist() == pytest.approx([(22.4 + 44.8) / 2, 33.6])
    assert values["pixel_error_1"].tolist() == pytest.approx([44.8, 33.6])
    assert values["pixel_error_2"].tolist() == pytest.approx([22.4, float("nan")], nan_ok=True)


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


def test_every_experiment_counts_once_whatever_its_targets() -> None:
    whole, split = position_metrics(3), position_metrics(3)
    whole.update(prediction(), targets())
    for row in (slice(0, 1), slice(1, 2)):
        split.update(Prediction(prediction().position[row]), take(targets(), row))
    assert whole.compute() == split.compute()


def test_a_perfect_prediction_has_no_error() -> None:
    metrics = position_metrics(3)
    metrics.update(Prediction(targets().position), targets())
    assert all(value == 0 for value in metrics.compute().values())


def test_losses_ignore_empty_slots() -> None:
    assert position_loss(prediction(), targets()) == pytest.approx((9 / 3 + 25 / 3 + 36 / 3) / 6)
    wrong = torch.tensor([3 * 9.0]) / 6  # three confident mistakes of six
    torch.testing.assert_close(stability_loss(prediction().stable_logit, targets()), wrong[0], atol=1e-3, rtol=0)
    empty = ~targets().presence[:, None, :, None]
    nonsense = replace(prediction(), position=prediction().position.masked_fill(empty, torch.nan))
    assert position_loss(nonsense, targets()) == position_loss(prediction(), targets())


def test_a_logit_for_the_sequence_is_held_against_being_always_stable() -> None:
    assert stability_target(torch.zeros(2, 1, 2), targets()).tolist() == [[[True, False]], [[False, False]]]


def test_what_a_mean_owes_to_its_draws_is_no_error() -> None:
    position = targets().position.clone()
    position[..., 0] += 3.0
    variance = torch.zeros_like(position)
    variance[..., 0] = 4.0
    said = Prediction(position, draw_variance=variance)
    for dims in (2, 3):
        assert mean_squared_error(dims)(said, targets()).tolist() == pytest.approx([5.0 / dims] * 2)
