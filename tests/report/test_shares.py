"""Errors of stored predictions are those that runs were judged by."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cophy.report.predictions import Errors, stored_errors
from cophy.report.tables import share_of_gain
from cophy.training.metrics import mean_squared_error
from cophy.training.predictor import prediction_arrays
from cophy.training.run import write_predictions
from cophy.types import Batch, Prediction


@pytest.mark.parametrize("variance", [None, 0.25])
@pytest.mark.parametrize("dims", [2, 3])
def test_stored_errors_are_the_mse_of_each_experiment(
    dims: int, variance: float | None, tower_batch: Batch, tmp_path: Path
) -> None:
    position = tower_batch.inputs.observed[:, 1:]
    prediction = Prediction(position, draw_variance=None if variance is None else variance * torch.rand_like(position))
    write_predictions(tmp_path, prediction_arrays(prediction, tower_batch.targets))
    found = stored_errors({"directory": tmp_path, "metric_dims": dims})
    expected = mean_squared_error(dims)(prediction, tower_batch.targets).numpy()
    np.testing.assert_allclose(found.mse, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(found.pair, np.arange(len(tower_batch)) // 2)


def test_a_share_is_of_the_experiments_that_all_were_tested_on() -> None:
    pairs = np.arange(40) // 2
    ours = [Errors(np.where(pairs < 10, 2.0, 100.0), pairs, pairs)]
    without, with_ab = ([Errors(np.full(20, mse), pairs[:20], pairs[:20])] for mse in (5.0, 1.0))
    assert share_of_gain(ours, without, with_ab) == pytest.approx((0.75, 0.75, 0.75))
    other_pairs = [Errors(np.full(20, 1.0), pairs[2:22], pairs[2:22])]
    assert np.isnan(share_of_gain(ours, without, other_pairs).value)
    other_data = [Errors(np.full(20, 1.0), pairs[:20], pairs[:20] + 0.5)]  # whose pairs have the same numbers
    assert np.isnan(share_of_gain(ours, without, other_data).value)
    assert np.isnan(share_of_gain([], without, with_ab).value)
