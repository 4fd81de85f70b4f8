"""What train.py leaves of a run, with numbers that are known."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from cophy.training.predictor import prediction_arrays
from cophy.training.run import write_predictions
from cophy.types import Prediction, Targets
from tests.report.lines import run

NOT_WRITTEN = ("error", "directory", "changes", "data", "variant", "validation_mse", "inputs")  # by earlier versions
PLACE = Path("blocktower/3to3/cophynet/full/ground_truth/seed0")


def content(**changes: Any) -> dict[str, Any]:
    """metrics.json of a run."""
    line = run("cophynet") | {"dataset_ids": ["3-x"], "metrics": {"mse": 0.2}, "intervals": {"mse": [0.1, 0.3]}}
    line |= {"max_epochs": 80, "metric_dims": 3, "num_test": 4}
    return {key: value for key, value in (line | changes).items() if key not in NOT_WRITTEN or key in changes}


def leave(directory: Path, metrics: str | bytes, error: float = 0.0) -> None:
    """What train.py leaves of a run, with predictions of two twin pairs that are all `error` metres off in every coordinate."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "metrics.json").write_bytes(metrics.encode() if isinstance(metrics, str) else metrics)
    position, present = torch.zeros(4, 5, 3, 3), torch.ones(4, 3, dtype=torch.bool)
    targets = Targets(
        position, torch.ones(4, 5, 3, dtype=torch.bool), present, position[:, 0], present,
        torch.zeros(4, 3, 2, dtype=torch.long), torch.arange(4) // 2, torch.zeros(4, dtype=torch.long),
    )  # fmt: skip
    write_predictions(
        directory, prediction_arrays(Prediction(position + error), targets, np.arange(4), np.arange(4) // 2)
    )
