"""Metrics in training and losses against values worked out by hand, and the scores of a test split."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from cophy.errors import CophyError
from cophy.scenario import Task
from cophy.training.losses import confounder_loss, position_loss, stability_loss, stability_target
from cophy.training.metrics import (
    MeanOfEachCell,
    StandingConfusion,
    collection,
    own_measures,
    position_measures,
    stability_measures,
    twin_collection,
)
from cophy.types import Batch, Prediction, Targets, take
from tests.models.networks import random_batch
from tests.training.scored import scored

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


def test_sequence_stability_needs_every_step() -> None:
    """First experiment: both objects are predicted wrongly; second: both are predicted to move."""
    stays = replace(prediction(), stable_logit=torch.tensor([[[9.0, 9.0], [-9.0, 9.0]], [[9.0, 9.0], [9.0, -9.0]]]))
    values = [metric.measure(stays, targets()) for metric in stability_metrics().values()]
    names = list(stability_metrics())
    assert values[names.index("sequence_stability_accuracy")].tolist() == [0.0, 1.0]


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


@pytest.mark.parametrize("name", ["mse", "position_loss", "pixel_error", "probe_accuracy"])
def test_a_name_of_another_metric_is_refused(name: str) -> None:
    with pytest.raises(CophyError, match=rf"metrics\.{name}: there is a metric or loss of this name"):
        own_measures({name: OWN}, ("mse",))


def test_one_logit_per_sequence_predicts_being_always_stable() -> None:
    assert stability_target(torch.zeros(2, 1, 2), targets()).tolist() == [[[True, False]], [[False, False]]]


def test_a_prediction_that_is_not_finite_is_an_error(tower_batch: Batch, scenario_of) -> None:
    scenario, targets = scenario_of("blocktower"), tower_batch.targets
    position = targets.position.clone()
    position[3, 5] = torch.nan
    with pytest.raises(CophyError, match="non-finite"):
        scored(Prediction(position), targets, scenario)
    logit = torch.full_like(targets.position[..., 0], torch.nan)
    with pytest.raises(CophyError, match="non-finite"):
        scored(Prediction(targets.position, logit), targets, scenario)


def test_predictions_of_absent_objects_do_not_matter(tower_batch: Batch, scenario_of) -> None:
    targets = tower_batch.targets
    absent = torch.where(targets.presence[:, None, :, None], targets.position, torch.nan)
    assert scored(Prediction(absent), targets, scenario_of("blocktower")).mse.max() == 0


def test_the_pixel_error_by_height_is_the_mean_of_the_heights(tower_batch: Batch, scenario_of) -> None:
    """As in the paper's Table 1. Of towers whose top was removed the top does not count, of all the others it does."""
    shifted = Prediction(tower_batch.targets.position + torch.tensor([0.1, 0.0, 0.2]))
    scores = scored(shifted, tower_batch.targets, scenario_of("blocktower"))
    means = scores.means()
    heights = [means[f"pixel_error_{rank}"] for rank in (1, 2, 3)]
    assert np.isnan(scores.values["pixel_error_3"]).any()
    assert means["pixel_error_by_height"] == pytest.approx(np.mean(heights))
    assert means["pixel_error_by_height"] != pytest.approx(means["pixel_error"], rel=1e-6)


@pytest.mark.parametrize("dims", [2, 3])
def test_metrics_in_training_are_the_scores_of_the_test(dims: int, scenario_of) -> None:
    batch, scenario = random_batch(4, [3] * 12), scenario_of("blocktower", f"scenario.task.metric_dims={dims}")
    presence = batch.targets.presence[::2].repeat_interleave(2, dim=0)
    targets = replace(batch.targets, presence=presence, position=batch.targets.position.double())
    noisy = Prediction(targets.position + torch.randn(targets.position.shape), torch.randn(12, 6, 4))
    metrics = [
        collection(position_measures(scenario.task), prefix=""),
        collection(stability_measures(), prefix=""),
        twin_collection(dims, ""),
    ]
    means = scored(noisy, targets, scenario).means()
    for each in metrics:
        each.update(noisy, targets)
        for name, value in each.compute().items():
            assert float(value) == pytest.approx(means[name], rel=1e-6)


def test_every_cell_has_its_own_mean() -> None:
    cells = MeanOfEachCell(3)
    cells.update(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([0, 2, -1]))
    cells.update(torch.tensor([3.0]), torch.tensor([0]))
    torch.testing.assert_close(cells.compute(), torch.tensor([2.0, torch.nan, 2.0]).double(), equal_nan=True)


def test_experiments_of_a_cell_are_counted_in_every_precision() -> None:
    cells = MeanOfEachCell(1).to(torch.bfloat16)
    for _ in range(3):
        cells.update(torch.ones(200, dtype=torch.bfloat16), torch.zeros(200, dtype=torch.int64))
    assert cells.count.tolist() == [600]


def test_a_tower_stands_if_all_its_objects_do() -> None:
    targets = random_batch(4, [2, 2, 2, 2], num_frames=3).targets
    stands = torch.tensor([True, True, False, False])
    targets.stable[:] = stands[:, None, None]
    logit = torch.where(targets.presence[:, None], 1.0, -1.0).repeat(1, 2, 1)  # what is not there does not count
    slot = targets.presence[1].int().argmax()
    logit[1, 0, slot] = logit[2, 0, targets.presence[2].int().argmax()] = -1.0
    confusion = StandingConfusion()
    for rows in ([0, 1], [2, 3]):
        confusion.update(take(Prediction(targets.position, logit), rows), take(targets, rows))
    assert confusion.compute().tolist() == [[1, 1], [1, 1]]
