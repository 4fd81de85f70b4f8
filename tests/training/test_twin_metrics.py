"""Measures of twins of models and of the truth."""

import numpy as np
import pytest
import torch

from cophy.models.baselines import CopyB
from cophy.types import Batch
from tests.models.networks import build
from tests.training.scored import scored


def test_a_model_without_ab_explains_nothing_and_chooses_by_chance(tower_batch: Batch, scenario_of) -> None:
    with torch.no_grad():
        prediction = build("feedforward")(tower_batch.inputs)
    means = scored(prediction, tower_batch.targets, scenario_of("blocktower")).means()
    assert means["twin_difference_explained"] == pytest.approx(0.0, abs=1e-6)
    assert means["right_twin_chosen"] == 0.5


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
