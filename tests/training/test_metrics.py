"""Metrics against values worked out by hand."""

import pytest
import torch

from cophy.training.losses import position_loss, stability_loss, stability_target
from cophy.training.metrics import position_metrics, stability_metrics
from cophy.types import Batch, Prediction


def batch() -> Batch:
    """Two experiments, T = 3 frames, K = 2 slots: two objects, and one object beside an empty slot."""
    presence = torch.tensor([[True, True], [False, True]])
    target = torch.zeros(2, 2, 2, 3)
    stable = torch.tensor([[[1, 0], [1, 1]], [[0, 1], [0, 0]]], dtype=torch.bool)
    return Batch(
        torch.zeros(2, 3, 2, 3), presence, torch.zeros(2, 2, 3), presence, torch.zeros(2, 2, 12), target, stable
    )


def prediction() -> Prediction:
    position = torch.zeros(2, 2, 2, 3)
    position[0, 0, 0] = torch.tensor([3.0, 0.0, 0.0])  # first experiment, first step, first object
    position[0, 1, 1] = torch.tensor([0.0, 3.0, 4.0])  # last step, second object
    position[1, 1, 1] = torch.tensor([0.0, 0.0, 6.0])  # second experiment
    position[1, :, 0] = 1000.0  # empty slot
    return Prediction(position, torch.tensor([[[9.0, 9.0], [-9.0, 9.0]], [[-9.0, 9.0], [9.0, 9.0]]]))


def computed(metrics) -> dict[str, float]:
    metrics.update(prediction(), batch())
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


def test_every_experiment_counts_once_whatever_its_batch() -> None:
    whole, split = position_metrics(3), position_metrics(3)
    whole.update(prediction(), batch())
    for row in (slice(0, 1), slice(1, 2)):
        split.update(Prediction(prediction().position[row]), Batch(*(tensor[row] for tensor in batch())))
    assert whole.compute() == split.compute()


def test_a_perfect_prediction_has_no_error() -> None:
    metrics = position_metrics(3)
    metrics.update(Prediction(batch().target), batch())
    assert all(value == 0 for value in metrics.compute().values())


def test_losses_ignore_empty_slots() -> None:
    assert position_loss(prediction(), batch()) == pytest.approx((9 / 3 + 25 / 3 + 36 / 3) / 6)
    wrong = torch.tensor([3 * 9.0]) / 6  # three confident mistakes of six
    torch.testing.assert_close(stability_loss(prediction().stable_logit, batch()), wrong[0], atol=1e-3, rtol=0)


def test_a_logit_for_the_sequence_is_held_against_being_always_stable() -> None:
    assert stability_target(torch.zeros(2, 1, 2), batch()).tolist() == [[[True, False]], [[False, False]]]
