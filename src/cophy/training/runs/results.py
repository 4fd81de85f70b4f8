"""The files that a run leaves: metrics.json and predictions.npz, or failure.json."""

import io
import json
import logging
import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.bootstrap import Ratio, interval, mean
from cophy.errors import CophyError
from cophy.training.runs.identity import FAILURE, METRICS, PREDICTIONS, SWEEP, Run
from cophy.types import Prediction, Targets

log = logging.getLogger(__name__)

SAID = (
    "mse",
    "twin_difference_explained",
    "right_twin_chosen",
    "sequence_stability_accuracy",
    "probe_accuracy",
)  # in the log


@dataclass(frozen=True)
class Measured:
    """What a test measured.

    Attributes:
        values: Each measure, one value per test item, or one per item and column (`cophy.bootstrap.mean`).
        pairs: (item,) the twin pair that it is of.
        copies: MSE of each copy on the same test split; none where no D is predicted.
    """

    values: Mapping[str, np.ndarray | Ratio]
    pairs: np.ndarray
    copies: Mapping[str, float] = field(default_factory=dict)


def forget_results(run: Run) -> None:
    """Remove the results of an earlier run, so that they cannot pass for those of this one."""
    for name in (METRICS, PREDICTIONS, FAILURE):
        (run.directory / name).unlink(missing_ok=True)


def write_metrics(run: Run, measured: Measured, about: dict[str, Any]) -> dict[str, float]:
    """Write metrics.json, once and whole.

    Args:
        run: Whose names it starts with.
        measured: Its means and 95 % intervals are written.
        about: What else is known about the run: datasets, counts, seconds.

    Returns:
        The mean of every measure.
    """
    metrics = {name: mean(value) for name, value in measured.values.items()}
    intervals = {name: interval(value, measured.pairs) for name, value in measured.values.items()}
    found = {"metrics": metrics, "intervals": intervals, "copies": dict(measured.copies)}
    _write_json(run.directory / METRICS, {**run.names(), **about, **found})
    said = "  ".join(f"{name} {metrics[name]:.4f}" for name in SAID if name in metrics)
    log.info("%s: %s", run.directory / METRICS, said)
    return metrics


def write_failure(run: Run, error: BaseException, *, has_begun: bool) -> None:
    """Leave a note that the run failed, so that the report can say so; not of one that was refused before it began.

    Args:
        run: Whose names it starts with.
        error: Why.
        has_begun: Whether it got so far that it trains or tests.
    """
    what = " ".join(f"{type(error).__name__}: {error}".split())
    about = {"has_begun": has_begun, "error": what, "sweep": os.environ.get(SWEEP)}
    _write_json(run.directory / FAILURE, {**run.names(), **about})


def write_predictions(directory: Path, prediction: Prediction, targets: Targets) -> None:
    """Keep what was predicted on the test split beside the truth, for figures and paired comparisons.

    Args:
        directory: Of the run.
        prediction: What was predicted.
        targets: The truth.
    """
    arrays = {
        "initial": targets.initial.numpy(),
        "presence": targets.presence.numpy(),
        "target": targets.position.numpy(),
        "position": prediction.position.numpy(),
        "pair": targets.pair.numpy(),
    }
    if prediction.draw_variance is not None:
        arrays["draw_variance"] = prediction.draw_variance.numpy()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    write_atomically(directory / PREDICTIONS, file.getvalue())


def read_predictions(directory: Path) -> dict[str, np.ndarray]:
    """What a run predicted on its test split, beside the truth; a damaged file is an error that names it.

    An oracle's also has `draw_variance`, see `Prediction`.
    """
    path = directory / PREDICTIONS
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            optional = [name for name in ("draw_variance",) if name in file]
            found = {name: file[name] for name in ("initial", "presence", "target", "position", "pair", *optional)}
        _check_shapes(found)
    except (OSError, ValueError, KeyError, EOFError, MemoryError, BadZipFile, zlib.error) as error:
        raise CophyError(f"{path} is missing or damaged ({error}): make that run again") from error
    return found


def _check_shapes(found: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError where arrays are not those of one test split, or hold what is no number."""
    target = found["target"]
    count, steps, slots, _ = target.shape
    expected: dict[str, tuple[int, ...]] = dict.fromkeys(found, (count, steps, slots, 3))
    expected |= {"initial": (count, slots, 3), "presence": (count, slots), "pair": (count,)}
    wrong = [name for name, array in found.items() if array.shape != expected[name]]
    if wrong or found["presence"].dtype != bool or not np.issubdtype(found["pair"].dtype, np.integer):
        raise ValueError(f"shape or type of {', '.join(wrong) or 'presence or pair'}")
    numbers = {name: found[name] for name in found if name not in ("presence", "pair")}
    if bad := [name for name, array in numbers.items() if array.dtype.kind != "f" or not np.isfinite(array).all()]:
        raise ValueError(f"no finite numbers in {', '.join(bad)}")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())
