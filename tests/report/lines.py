"""Lines of the table of runs (`read_runs`), with numbers that are known."""

from pathlib import Path
from typing import Any

import numpy as np

from cophy.scoring import Scores


def run(model: str, ablation: str = "full", seed: int = 0, **changes: Any) -> dict[str, Any]:
    line = {
        "scenario": "blocktower", "split": "3to3", "model": model, "ablation": ablation, "positions": "ground_truth",
        "seed": seed, "size": "small", "num_train": 2800, "num_test": 400, "training_seconds": 100.0,
        "wall_seconds": 110.0, "epochs": 40, "error": None, "directory": Path("runs"),
        "is_trained": True, "predictor": None, "variant": "", "changes": (), "data": "", "dataset_ids": ["3-x"],
        "validation_mse": np.nan, "inputs": [],
    }  # fmt: skip
    return line | changes


def measured(metric: str, value: float, *names: str, **changes: Any) -> dict[str, Any]:
    return run(*names, **changes) | {
        f"metrics.{metric}": value,
        f"low.{metric}": value - 0.01,
        f"high.{metric}": value + 0.02,
    }


def scores_of_mse(mse: np.ndarray, pair: np.ndarray) -> Scores:
    """The first experiments of a dataset with this MSE each."""
    return Scores(np.arange(len(mse)), pair, pair.astype(float), {"mse": mse})
