"""A test in numbers."""

import numpy as np
import pytest
import torch

from cophy.bootstrap import mean
from cophy.errors import CophyError
from cophy.training.evaluation import evaluate
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


def test_the_pixel_error_by_height_is_the_mean_of_the_heights(tower_batch: Batch, scenario_of) -> None:
    """As in the paper's Table 1. Of towers whose top was removed the top does not count, of all the others it does."""
    shifted = Prediction(tower_batch.targets.position + torch.tensor([0.1, 0.0, 0.2]))
    values = evaluate(shifted, tower_batch.targets, scenario_of("blocktower"))
    heights = [mean(values[f"pixel_error_{rank}"]) for rank in (1, 2, 3)]
    assert np.isnan(values["pixel_error_3"]).any()
    assert mean(values["pixel_error_by_height"]) == pytest.approx(np.mean(heights))
    assert mean(values["pixel_error_by_height"]) != pytest.approx(mean(values["pixel_error"]), rel=1e-6)
