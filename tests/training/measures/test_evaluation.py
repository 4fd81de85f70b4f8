"""A test in numbers."""

import pytest
import torch

from cophy.errors import CophyError
from cophy.training.measures.evaluation import evaluate
from cophy.types import Batch, Prediction


def test_a_prediction_that_is_not_finite_is_an_error(tower_batch: Batch, scenario_of) -> None:
    scenario, targets = scenario_of("blocktower"), tower_batch.targets
    position = targets.position.clone()
    position[3, 5] = torch.nan
    with pytest.raises(CophyError, match="not finite"):
        evaluate(Prediction(position), targets, scenario)
    logit = torch.full_like(targets.position[..., 0], torch.nan)
    with pytest.raises(CophyError, match="not finite"):
        evaluate(Prediction(targets.position, logit), targets, scenario)


def test_what_is_predicted_of_absent_objects_does_not_matter(tower_batch: Batch, scenario_of) -> None:
    targets = tower_batch.targets
    absent = torch.where(targets.presence[:, None, :, None], targets.position, torch.nan)
    assert evaluate(Prediction(absent), targets, scenario_of("blocktower"))["mse"].max() == 0
