"""What the report needs of the predictions of runs; each predictions.npz is decompressed once."""

import logging
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cophy.drawing.plots import error_over_time
from cophy.errors import CophyError
from cophy.report.tables import Errors, errors_of_predictions
from cophy.training.run import read_predictions

log = logging.getLogger(__name__)

NUM_EXAMPLES = 2  # one twin pair, which shares C but not D
NUM_THREADS = 4  # zlib releases the GIL


@dataclass(frozen=True)
class StoredPredictions:
    """Summary of predictions.npz of one run.

    Attributes:
        errors: Per experiment.
        error_over_time: (T-1,) mean position error, m.
        examples: The arrays of the first experiments, see `read_predictions`.
        arrays: All arrays, where they were asked for; else None.
    """

    errors: Errors
    error_over_time: np.ndarray
    examples: dict[str, np.ndarray]
    arrays: dict[str, np.ndarray] | None


def read_stored_predictions(runs: pd.DataFrame, whole: Iterable[Path] = ()) -> dict[Path, StoredPredictions]:
    """Return directory -> predictions of finished predictors; the log names those that are missing or damaged.

    Args:
        runs: See `read_runs`.
        whole: Directories of the runs of which all arrays are kept in memory.
    """
    keep = set(whole)

    def read(run: dict[Any, Any]) -> StoredPredictions | None:
        try:
            arrays = read_predictions(run["directory"])
        except CophyError as error:
            log.warning("%s is skipped: %s", run["directory"], error)
            return None
        dims = int(run["metric_dims"])
        curve = error_over_time(arrays["position"], arrays["target"], arrays["presence"], dims=dims)
        examples = {name: array[:NUM_EXAMPLES].copy() for name, array in arrays.items()}
        whole_arrays = arrays if run["directory"] in keep else None
        return StoredPredictions(errors_of_predictions(arrays, dims), curve, examples, whole_arrays)

    lines = runs.to_dict("records")
    with ThreadPoolExecutor(NUM_THREADS) as threads:
        stored = threads.map(read, lines)
        return {run["directory"]: one for run, one in zip(lines, stored, strict=True) if one is not None}
