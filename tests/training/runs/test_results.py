"""The files that a run leaves."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from cophy.errors import CophyError
from cophy.training.run import (
    Measured,
    Run,
    forget_results,
    read_predictions,
    write_failure,
    write_metrics,
    write_predictions,
)
from cophy.types import Batch, Prediction


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run("balls", "4to4", "cophynet", "full", "ground_truth", 1, "tiny", "", tmp_path)


def test_metrics_are_means_with_their_intervals(run: Run) -> None:
    copies = {"copy_c": 5.0}
    measured = Measured({"mse": np.array([1.0, 3.0, 2.0, 2.0])}, np.array([0, 0, 1, 1]), copies)
    assert write_metrics(run, measured, {"num_test": 4}) == {"mse": 2.0}
    content = json.loads((run.directory / "metrics.json").read_text())
    found = {"metrics": {"mse": 2.0}, "intervals": {"mse": [2.0, 2.0]}, "copies": copies}
    assert content == {**run.names(), "num_test": 4, **found}


def test_a_new_start_forgets_what_was_there(run: Run) -> None:
    write_failure(run, ValueError("two\nlines"), has_begun=True)
    assert json.loads((run.directory / "failure.json").read_text())["error"] == "ValueError: two lines"
    forget_results(run)
    assert not list(run.directory.iterdir())


def test_predictions_come_back_as_they_were(run: Run, tower_batch: Batch) -> None:
    targets = tower_batch.targets
    write_predictions(run.directory, Prediction(targets.position + 1), targets)
    found = read_predictions(run.directory)
    np.testing.assert_array_equal(found["position"], (targets.position + 1).numpy())
    np.testing.assert_array_equal(found["target"], targets.position.numpy())
    assert torch.equal(torch.from_numpy(found["presence"]), targets.presence)
    path = run.directory / "predictions.npz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CophyError, match=r"predictions\.npz is missing or damaged .* make that run again"):
        read_predictions(run.directory)
