"""Stored predictions of runs: errors per experiment and over time, and examples."""

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.drawing.plots import error_over_time
from cophy.errors import CophyError
from cophy.training.run import read_predictions

log = logging.getLogger(__name__)

NUM_EXAMPLES = 2  # one twin pair, which shares C but not D
NUM_THREADS = 4  # zlib releases the GIL


class Errors(NamedTuple):
    """Errors of a run.

    Attributes:
        mse: (experiment,) mean squared error, m².
        pair: (experiment,) twin pair of the experiment.
        truth: (experiment,) sum of the true coordinates, m; it tells experiments of different data apart.
    """

    mse: np.ndarray
    pair: np.ndarray
    truth: np.ndarray


def stored_errors(run: dict[Any, Any]) -> Errors:
    """Return the errors of the predictions that a run stored."""
    return errors_of_predictions(read_predictions(run["directory"]), int(run["metric_dims"]))


def errors_of_predictions(predictions: dict[str, np.ndarray], dims: int) -> Errors:
    """Return the errors of stored predictions (see `read_predictions`) in the first `dims` coordinates."""
    error = np.square(predictions["position"] - predictions["target"]) - predictions.get("draw_variance", 0.0)
    squared, present = error[..., :dims].mean(axis=(1, 3), dtype=np.float64), predictions["presence"]
    truth = predictions["target"].sum(axis=(1, 2, 3), dtype=np.float64)
    return Errors(np.where(present, squared, 0.0).sum(axis=1) / present.sum(axis=1), predictions["pair"], truth)


@dataclass(frozen=True)
class StoredPredictions:
    """Summary of predictions.npz of one run.

    Attributes:
        errors: Per experiment.
        error_over_time: (T-1,) mean position error, m.
        examples: The arrays of the first experiments, see `read_predictions`.
    """

    errors: Errors
    error_over_time: np.ndarray
    examples: dict[str, np.ndarray]


def read_stored_predictions(runs: pd.DataFrame) -> dict[Path, StoredPredictions]:
    """Return directory -> predictions of finished predictors; the log names those that are missing or damaged.

    Args:
        runs: See `read_runs`.
    """
    lines = runs.to_dict("records")
    with ThreadPoolExecutor(NUM_THREADS) as threads:
        stored = dict(zip((line["directory"] for line in lines), threads.map(_read, lines), strict=True))
    return {directory: predictions for directory, predictions in stored.items() if predictions is not None}


def _read(run: dict[Any, Any]) -> StoredPredictions | None:
    try:
        arrays = read_predictions(run["directory"])
    except CophyError as error:
        log.warning("%s is skipped: %s", run["directory"], error)
        return None
    dims = int(run["metric_dims"])
    curve = error_over_time(arrays["position"], arrays["target"], arrays["presence"], dims=dims)
    examples = {name: array[:NUM_EXAMPLES].copy() for name, array in arrays.items()}
    return StoredPredictions(errors_of_predictions(arrays, dims), curve, examples)
