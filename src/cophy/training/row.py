"""Where a run belongs, and the files it leaves."""

import io
import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cophy.files import write_atomically
from cophy.intervals import interval, mean
from cophy.types import Batch, Prediction

log = logging.getLogger(__name__)

METRICS, PREDICTIONS, FAILURE = "metrics.json", "predictions.npz", "failure.json"


@dataclass(frozen=True)
class Row:
    """The names under which a run was chosen, and its directory."""

    scenario: str
    split: str
    model: str
    ablation: str
    positions: str
    seed: int
    size: str
    directory: Path

    def names(self) -> dict[str, Any]:
        """The names alone."""
        return {key: value for key, value in vars(self).items() if key != "directory"}

    @property
    def place(self) -> Path:
        """The directory's path below the root of all runs (conf/train.yaml, hydra.run.dir)."""
        return Path(self.scenario, self.split, self.model, self.ablation, self.positions, f"seed{self.seed}")

    @property
    def root(self) -> Path | None:
        """The root of all runs, where the run lies in its place below it."""
        depth = len(self.place.parts)
        return self.directory.parents[depth - 1] if self.directory.parts[-depth:] == self.place.parts else None

    def start(self) -> None:
        """Forget the results of an earlier run: a stopped one must not pass for the one before it."""
        for name in (METRICS, PREDICTIONS, FAILURE):
            (self.directory / name).unlink(missing_ok=True)

    def finish(self, values: dict[str, np.ndarray], pairs: np.ndarray, about: dict[str, Any]) -> dict[str, float]:
        """Write metrics.json, once and whole: names, what is known about the run, each metric and its 95 % interval.

        values: each metric per test item; pairs: the twin pair that each item is of.
        """
        metrics = {name: mean(value) for name, value in values.items()}
        intervals = {name: interval(value, pairs) for name, value in values.items()}
        content = {**self.names(), **about, "metrics": metrics, "intervals": intervals}
        write_atomically(self.directory / METRICS, (json.dumps(content, indent=2) + "\n").encode())
        main = ("mse", "final_position_error", "sequence_stability_accuracy", "probe_accuracy")
        found = "  ".join(f"{name} {metrics[name]:.4f}" for name in main if name in metrics)
        log.info("%s: %s", self.directory / METRICS, found)
        return metrics

    def write_predictions(self, prediction: Prediction, batch: Batch) -> None:
        """Keep what was predicted on the test split beside the truth, for figures and paired comparisons."""
        arrays = {
            "initial": batch.target_initial,
            "presence": batch.target_presence,
            "target": batch.target,
            "position": prediction.position,
        }
        file = io.BytesIO()
        numpy_arrays: Any = {name: tensor.numpy() for name, tensor in arrays.items()}
        np.savez_compressed(file, **numpy_arrays)
        write_atomically(self.directory / PREDICTIONS, file.getvalue())

    def fail(self, error: BaseException) -> None:
        """Leave a note that the run failed, so that the report can say so."""
        content = {**self.names(), "error": " ".join(f"{type(error).__name__}: {error}".split())}
        write_atomically(self.directory / FAILURE, (json.dumps(content, indent=2) + "\n").encode())
