"""Measures of twins of models and of the truth."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cophy.models.baselines import CopyB, CopyC
from cophy.types import Batch, Prediction
from tests.models.networks import build
from tests.training.scored import scored


@pytest.mark.parametrize("choice", ["feedforward", "in", "npe", "copy_c"])
def test_a_model_without_ab_explains_nothing_and_chooses_by_chance(
    choice: str, tower_batch: Batch, scenario_of
) -> None:
    with torch.no_grad():
        prediction = build(choice)(tower_batch.inputs)
    means = scored(prediction, tower_batch.targets, scenario_of("blocktower")).means()
    assert means["twin_difference_explained"] == pytest.approx(0.0, abs=1e-6)
    assert means["right_twin_chosen"] == 0.5


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
