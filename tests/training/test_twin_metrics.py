"""Measures of twins against values worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cophy.models.baselines import CopyB, CopyC
from cophy.training.metrics import have_twins, right_twin_chosen, twin_collection, twin_difference, twin_of
from cophy.types import Batch, Prediction, Targets, take
from tests.models.networks import build, random_batch
from tests.training.scored import scored


def two_pairs() -> Targets:
    """Two twin pairs, one step, one object: D of the first pair differs by 2 m in x, of the second by 4 m in y."""
    targets = take(random_batch(2, [2, 2, 2, 2], num_frames=2).targets, slice(4))
    position = torch.zeros(4, 1, 2, 3)
    position[1, 0, 0, 0], position[3, 0, 0, 1] = 2.0, 4.0
    presence = torch.tensor([[True, False]]).expand(4, 2)
    return replace(targets, position=position, presence=presence, stable=torch.zeros(4, 1, 2, dtype=torch.bool))


def predicted(*x: float) -> Prediction:
    """The object of every experiment at this place on the x axis; the empty slot anywhere."""
    position = torch.full((4, 1, 2, 3), 7.0)
    position[:, 0, 0] = torch.tensor([[each, 0.0, 0.0] for each in x])
    position[1::2, :, 1] = -50.0
    return Prediction(position)


def test_twins_are_next_to_each_other() -> None:
    assert twin_of(torch.tensor([3, 3, 7, 8, 8, 9])).tolist() == [1, 0, 2, 4, 3, 5]
    assert not have_twins(torch.tensor([1, 2, 3]))


def test_the_difference_explained_is_that_of_the_formula() -> None:
    """ΔP = 1 m of the true 2 m in the first pair, nothing of 4 m in the second: 1 - (1 + 16) / (4 + 16)."""
    metrics = twin_collection(3, "")
    metrics.update(predicted(0.0, 1.0, 5.0, 5.0), two_pairs())
    assert float(metrics.compute()["twin_difference_explained"]) == pytest.approx(1 - 17 / 20)


def test_the_right_twin_is_the_nearer_one() -> None:
    chosen = right_twin_chosen(predicted(0.5, 0.9, 3.0, 3.0), two_pairs(), 3)
    assert chosen.tolist() == [1.0, 0.0, 1.0, 0.0]
    assert right_twin_chosen(predicted(1.0, 1.0, 0.0, 0.0), two_pairs(), 3).tolist() == [0.5, 0.5, 1.0, 0.0]


def test_only_coordinates_that_count_do() -> None:
    difference = twin_difference(predicted(0.0, 0.0, 0.0, 0.0), two_pairs(), dims=1)
    assert difference.size.tolist() == [4.0, 4.0, 0.0, 0.0]


def test_batches_add_up() -> None:
    whole, parts, prediction = twin_collection(3, ""), twin_collection(3, ""), predicted(0.0, 1.0, 2.0, 5.0)
    whole.update(prediction, two_pairs())
    for part in (slice(0, 2), slice(2, 4)):
        parts.update(take(prediction, part), take(two_pairs(), part))
    assert {name: float(value) for name, value in whole.compute().items()} == {
        name: float(value) for name, value in parts.compute().items()
    }


@pytest.mark.parametrize("choice", ["feedforward", "in", "npe", "copy_c"])
def test_a_model_without_ab_explains_nothing_and_chooses_by_chance(
    choice: str, tower_batch: Batch, scenario_of
) -> None:
    with torch.no_grad():
        prediction = build(choice)(tower_batch.inputs)
    means = scored(prediction, tower_batch.targets, scenario_of("blocktower")).means()
    assert means["twin_difference_explained"] == pytest.approx(0.0, abs=1e-6)
    assert means["right_twin_chosen"] == 0.5


def test_an_experiment_without_its_twin_is_left_out_without_a_warning() -> None:
    targets = two_pairs()
    targets = replace(targets, pair=torch.tensor([0, 0, 1, 2]))
    metrics = twin_collection(3, "")
    metrics.update(Prediction(targets.position), targets)
    assert {name: float(value) for name, value in metrics.compute().items()} == {
        "twin_difference_explained": 1.0,
        "right_twin_chosen": 1.0,
    }


def test_the_truth_explains_everything(tower_batch: Batch, scenario_of) -> None:
    means = scored(Prediction(tower_batch.targets.position), tower_batch.targets, scenario_of("blocktower")).means()
    assert means["twin_difference_explained"] == 1.0
    assert means["right_twin_chosen"] == 1.0


def test_data_without_twins_have_no_such_measure(tower_batch: Batch, scenario_of) -> None:
    alone = replace(tower_batch.targets, pair=torch.arange(len(tower_batch)))
    values = scored(CopyC()(tower_batch.inputs), alone, scenario_of("blocktower")).values
    assert "twin_difference_explained" not in values
    assert "right_twin_chosen" not in values


def test_the_twins_of_copy_b_differ_as_their_ab_do(tower_batch: Batch, scenario_of) -> None:
    inputs, targets = tower_batch.inputs, tower_batch.targets
    present = targets.presence[:, None, :, None].numpy()
    observed, true = (
        np.where(present, each.double().numpy(), 0) for each in (inputs.observed[:, 1:], targets.position)
    )
    delta_p, delta_d = observed[::2] - observed[1::2], true[::2] - true[1::2]
    expected = 1 - np.square(delta_p - delta_d).sum() / np.square(delta_d).sum()
    means = scored(CopyB()(inputs), targets, scenario_of("blocktower")).means()
    assert means["twin_difference_explained"] == pytest.approx(expected, abs=1e-6)
