"""Stored predictions of runs: scores per experiment, errors over time, and examples."""

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student_t

from cophy.bootstrap import MIN_CLUSTERS, variance_of_mean
from cophy.drawing.plots import error_over_time
from cophy.errors import CophyError
from cophy.scoring import Predictions, Scores, Truth, score
from cophy.training.run import read_predictions

log = logging.getLogger(__name__)

NUM_EXAMPLES = 2  # one twin pair, which shares C but not D
RELATIVE_MSE_TOLERANCE = 1e-6  # metrics.json has all digits
NUM_THREADS = 4  # zlib releases the GIL


def stored_scores(run: dict[Any, Any]) -> Scores:
    """Return the scores of the predictions that a run stored, without pixel errors."""
    return scores_of(read_predictions(run["directory"]), int(run["metric_dims"]))


def scores_of(arrays: dict[str, np.ndarray], dims: int) -> Scores:
    """Return the scores of stored predictions (see `read_predictions`), with metrics in the first `dims` coordinates."""
    return score(Predictions.from_arrays(arrays), Truth.from_arrays(arrays, metric_dims=dims))


@dataclass(frozen=True)
class StoredPredictions:
    """Summary of predictions.npz of one run.

    Attributes:
        scores: Per experiment.
        error_over_time: (T-1,) mean position error, m.
        half_width: (T-1,) half of its 95 % interval over clusters, m; NaN for fewer than MIN_CLUSTERS.
        examples: The arrays of the first experiments, see `read_predictions`.
    """

    scores: Scores
    error_over_time: np.ndarray
    half_width: np.ndarray
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
        arrays, dims = read_predictions(run["directory"]), int(run["metric_dims"])
        if len(arrays["target"]) != run["num_test"]:
            raise CophyError(f"its predictions are not those of {run['num_test']:.0f} test experiments: run it again")
        scores = scores_of(arrays, dims)
        if not np.isclose(mse := scores.mse.mean(), run["metrics.mse"], rtol=RELATIVE_MSE_TOLERANCE):
            message = f"its predictions have MSE {mse:.6f}, its metrics.json says {run['metrics.mse']:.6f}"
            raise CophyError(f"{message}: run it again")
    except (CophyError, OSError) as error:
        log.warning("%s is skipped: %s", run["directory"], error)
        return None
    errors = error_over_time(arrays["position"], arrays["target"], arrays["presence"], dims=dims)
    examples = {name: array[:NUM_EXAMPLES].copy() for name, array in arrays.items()}
    return StoredPredictions(scores, errors.mean(axis=0), interval_half_width(errors, scores.cluster), examples)


def interval_half_width(errors: np.ndarray, clusters: np.ndarray) -> np.ndarray:
    """Return (T-1,) half of the 95 % interval of the mean of (experiment, T-1) errors, over clusters; NaN for fewer than MIN_CLUSTERS."""
    variance, degrees = variance_of_mean(errors, clusters)
    quantile = student_t.ppf(0.975, degrees) if degrees >= MIN_CLUSTERS - 1 else np.nan
    return np.asarray(quantile * np.sqrt(variance))
