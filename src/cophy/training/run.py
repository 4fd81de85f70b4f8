"""One run of train.py: its names, its directory, the lock on it, and the files of results in it.

A run writes metrics.json and predictions.npz when its test is over, or failure.json. One process at a time works in the
directory. Results of another run are never replaced, and earlier results of the same run only once it really starts.
"""

import io
import json
import logging
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import DictConfig, ListConfig, OmegaConf

from cophy.atomic_files import read_json, read_npz, write_atomically
from cophy.errors import CophyError
from cophy.locks import locked

if TYPE_CHECKING:
    from cophy.bootstrap import Ratio

log = logging.getLogger(__name__)

METRICS, PREDICTIONS, FAILURE = "metrics.json", "predictions.npz", "failure.json"  # in the directory of a run
ARRAYS = {  # of predictions.npz: kinds of numbers, and axes: n experiments, t frames 1 … T-1, k slots; see `read_predictions`
    **dict.fromkeys(("experiment", "pair", "cluster", "cell"), ("iu", "n")),
    **dict.fromkeys(("target", "position"), ("f", "n t k 3")),
    **{"initial": ("f", "n k 3"), "presence": ("b", "n k"), "stable": ("b", "n t k")},
}
OPTIONAL_ARRAYS = {
    **{"stable_logit": ("f", "n t|1 k"), "draw_variance": ("f", "n t k 3"), "estimate": ("f", "n k any")},
    **dict.fromkeys(("confounder_class", "probe_mass_and_friction"), ("i", "n k 2")),
    **{"probe_mass": ("i", "n k"), "probe_friction": ("i", "n k"), "probe_most_frequent": ("i", "2")},
}
LARGEST_NUMBER = 1e15  # ours: its square is finite in single precision
TESTED_CHECKPOINT, SCORED_FILE = (
    "predictor",
    "predictions",
)  # keys of commands, and of metrics.json with the file's hash
SWEEP = "COPHY_SWEEP"  # environment variable: a unique name of the sweep that a run belongs to
LOGGED = (  # metrics in the last line of a run's log
    *("mse", "twin_difference_explained", "right_twin_chosen", "sequence_stability_accuracy", "probe_accuracy"),
)
RUN_NAMES = ("scenario", "split", "model", "ablation", "positions", "seed", "size", "variant")
# keys without effect on results: where and how fast a run computes, what is displayed, and the names of a scenario's splits
NO_RESULT = {
    *("trainer.accelerator", "trainer.devices", "trainer.num_nodes", "trainer.strategy", "trainer.profiler"),
    *("trainer.enable_progress_bar", "trainer.enable_model_summary", "trainer.log_every_n_steps"),
    "scenario.task.splits",
}


@dataclass(frozen=True)
class Results:
    """The outcome of a test.

    Attributes:
        values: Each metric, with one value per test item, or one per item and column (`cophy.bootstrap.mean`).
        clusters: (item,) cluster of each item, for the bootstrap: `ExperimentSet.clusters`.
        copies: MSE of each copy baseline on the same test split; empty for a de-renderer.
        predictions: Arrays for predictions.npz; empty for a de-renderer.
    """

    values: "Mapping[str, np.ndarray | Ratio]"
    clusters: np.ndarray
    copies: Mapping[str, float] = field(default_factory=dict)
    predictions: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass
class Run:
    """Names and directory of one run.

    Attributes:
        variant: Changes beyond the names, for example "+hidden_dim-8"; "" if there are none.
        directory: Where its files go.
        changes: The same changes with whole keys, for example "model.hidden_dim" -> "8".
        has_begun: Whether it has started to train or test.
    """

    scenario: str
    split: str
    model: str
    ablation: str
    positions: str
    seed: int
    size: str
    variant: str
    directory: Path
    changes: dict[str, str] = field(default_factory=dict, compare=False)
    has_begun: bool = field(default=False, init=False, compare=False)

    def names(self) -> dict[str, Any]:
        """Return the names without the directory."""
        return {name: getattr(self, name) for name in RUN_NAMES}

    @property
    def place(self) -> Path:
        """Path of the directory below the root of all runs (conf/train.yaml, hydra.run.dir)."""
        last = f"seed{self.seed}{self.variant}"
        return Path(self.scenario, self.split, self.model, self.ablation, self.positions, last)

    @property
    def short_name(self) -> str:
        """The place in one word, without the default ablation and positions."""
        defaults = {("ablation", "full"), ("positions", "ground_truth")}
        names = [(key, getattr(self, key)) for key in ("scenario", "split", "model", "ablation", "positions")]
        return "_".join([*(value for key, value in names if (key, value) not in defaults), self.place.name])

    @property
    def root(self) -> Path | None:
        """The root of all runs, or None if the directory is not at its place below one."""
        depth = len(self.place.parts)
        return self.directory.parents[depth - 1] if self.directory.parts[-depth:] == self.place.parts else None

    @property
    def checkpoints(self) -> Path:
        """The folder of its checkpoints."""
        return self.directory / "checkpoints"

    @contextmanager
    def locked(self, *, tests: str | None = None) -> Iterator[None]:
        """Lock the directory exclusively; if the run fails, write failure.json.

        Args:
            tests: What the run tests instead of training: TESTED_CHECKPOINT, SCORED_FILE or None.

        Raises:
            CophyError: Another process is making this run, or the directory has results that must not be replaced.
        """
        if not is_rank_zero():  # the first process locks it for all
            yield
            return
        self.directory.mkdir(parents=True, exist_ok=True)
        busy = f"{self.directory}: another process is making this run; wait until it is done"
        with locked(self.directory / ".lock", elsewhere="source.outputs=", busy=busy):
            self._check_earlier_results(tests)
            (self.directory / FAILURE).unlink(missing_ok=True)
            try:
                yield
            except Exception as error:
                with suppress(OSError):  # the disk may be full
                    self.write_failure(error)
                if isinstance(error, OSError) and error.errno is not None and error.filename is None:
                    error.filename = str(self.directory)  # of TensorBoard's files, for example
                raise

    def delete_earlier_results(self) -> None:
        """Delete earlier results. A run that is refused before this, by a wrong key or missing data, keeps them."""
        self.has_begun = True
        if is_rank_zero():
            for name in (METRICS, PREDICTIONS, FAILURE):
                (self.directory / name).unlink(missing_ok=True)

    def write_results(self, results: Results, facts: dict[str, Any]) -> dict[str, float]:
        """Write predictions.npz and metrics.json.

        Args:
            results: Their means and 95 % bootstrap intervals go into metrics.json.
            facts: Further keys of metrics.json: datasets, counts, seconds.

        Returns:
            The mean of every metric.
        """
        from cophy.bootstrap import interval, mean  # scipy takes a second to import; --help does not need it

        if results.predictions:
            write_predictions(self.directory, results.predictions)
        metrics = {name: mean(value) for name, value in results.values.items()}
        intervals = {name: interval(value, results.clusters) for name, value in results.values.items()}
        content = {"metrics": metrics, "intervals": intervals, "copies": dict(results.copies)}
        _write_json(self.directory / METRICS, {**self.names(), "changes": self.changes, **facts, **content})
        text = "  ".join(f"{name} {metrics[name]:.4f}" for name in LOGGED if name in metrics)
        log.info("%s: %s", self.directory / METRICS, text)
        return metrics

    def write_failure(self, error: BaseException) -> None:
        """Write failure.json, so that the report can name the run and the error."""
        message = " ".join(f"{type(error).__name__}: {error}".split())
        content = {"changes": self.changes, "has_begun": self.has_begun, "error": message}
        _write_json(self.directory / FAILURE, {**self.names(), **content, "sweep": os.environ.get(SWEEP)})

    def _check_earlier_results(self, tests: str | None) -> None:
        path = self.directory / METRICS
        try:
            content = read_json(path)
        except FileNotFoundError:
            return
        except ValueError as error:
            raise CophyError(f"{path} is damaged ({error}): delete it and run the command again") from error
        if others := [f"{key}={content.get(key)}" for key, name in self.names().items() if content.get(key) != name]:
            raise CophyError(
                f"{path} belongs to another run ({', '.join(others)}): choose another hydra.run.dir or delete it"
            )
        if tests is not None and content.get(tests) is None:
            raise CophyError(
                f"{path} belongs to a training with these settings: write the results of {tests}= elsewhere "
                f"({'name=' if tests == SCORED_FILE else 'source.outputs='}), or delete it"
            )
        if tests is None and content.get(SCORED_FILE) is not None:
            raise CophyError(f"{path} holds the scores of a file of predictions: rename the model, or delete it")


def is_rank_zero() -> bool:
    """Return whether this process decides and writes: the only one, or the first of a run on several devices."""
    if "torch" not in sys.modules:  # nothing is trained here
        return True
    from lightning.pytorch.utilities.rank_zero import rank_zero_only  # takes seconds to import; --help does not need it

    return getattr(rank_zero_only, "rank", 0) in (0, None)


def differences(key: str, value: Any, expected: Any) -> Iterator[tuple[str, Any]]:
    """Yield the keys that can change a result and whose values differ from the expected ones, with their values.

    Args:
        key: Name of both in the whole configuration.
    """
    if isinstance(value, dict) and isinstance(expected, dict):
        for name in sorted(value.keys() | expected.keys()):
            yield from differences(f"{key}.{name}", value.get(name), expected.get(name))
    elif value != expected and key not in NO_RESULT:
        yield key, value


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the leaves of nested dictionaries under dotted names."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def short_keys(keys: Iterable[str]) -> dict[str, str]:
    """Return each key with its last word, or with itself where another key ends in the same word."""
    last_words = {key: key.rpartition(".")[2] for key in keys}
    count = Counter(last_words.values())
    return {key: word if count[word] == 1 else key for key, word in last_words.items()}


def plain_value(config: DictConfig | ListConfig, key: str) -> Any:
    """Return the value of a key as dicts, lists and plain values, with enumerations by name."""
    node = OmegaConf.select(config, key)
    return OmegaConf.to_container(node, resolve=True, enum_to_str=True) if OmegaConf.is_config(node) else node


def write_predictions(directory: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write predictions.npz: the predictions of the test split and the truth, for figures and paired comparisons."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    write_atomically(directory / PREDICTIONS, file.getvalue())


def read_predictions(directory: Path) -> dict[str, np.ndarray]:
    """Read predictions.npz of a run: all that the metrics of metrics.json are computed from (`cophy.scoring`).

    Returns:
        Always: experiment (experiment,), indices in the dataset; position, target (experiment, T-1, K, 3), predicted and true
        D, metres; initial (experiment, K, 3), C; presence (experiment, K); stable (experiment, T-1, K), true; pair,
        cluster and cell (experiment,), see `cophy.scoring.Truth`. Empty slots are zero. Where the model has them, see `Prediction`: stable_logit, draw_variance, and
        estimate (experiment, K, any). Where the estimate was probed: the classes of `cophy.training.probe.probe`.

    Raises:
        CophyError: The file is missing or damaged.
    """
    path = directory / PREDICTIONS
    try:
        arrays = read_npz(path, list(ARRAYS), list(OPTIONAL_ARRAYS))
        _check_arrays(arrays)
    except ValueError as error:
        raise CophyError(f"{path} is missing or damaged ({error}): run its train.py command again") from error
    return arrays


def _check_arrays(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError if arrays are not those of one test split: shapes, types, numbers, and an object per experiment."""
    count, steps, slots, _ = arrays["target"].shape
    sizes = {"n": {count}, "t": {steps}, "t|1": {steps, 1}, "k": {slots}, "2": {2}, "3": {3}}

    def fits(array: np.ndarray, kinds: str, axes: str) -> bool:
        names = axes.split()
        if array.dtype.kind not in kinds or array.dtype.itemsize > 8 or array.ndim != len(names):
            return False
        return all(name == "any" or size in sizes[name] for name, size in zip(names, array.shape, strict=True))

    fields = ARRAYS | OPTIONAL_ARRAYS
    if wrong := [name for name, array in arrays.items() if not fits(array, *fields[name])]:
        raise ValueError(f"shape or type of {', '.join(wrong)}")
    if wrong := [name for name, array in arrays.items() if not (np.abs(array) <= LARGEST_NUMBER).all()]:
        raise ValueError(f"non-finite or huge numbers in {', '.join(wrong)}")
    if not count or not arrays["presence"].any(axis=1).all():
        raise ValueError("an experiment without objects, or none at all")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())
