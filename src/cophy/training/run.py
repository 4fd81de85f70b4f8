"""One process at a time makes a run; no run replaces the results of another, and none forgets its own before it begins.

Runs on several devices: a process for each. The first decides and writes, the others compute along.

Lightning starts the other processes, or SLURM has (docs/sweeps.md). Every process runs the whole command.
The names of a run, its place among the others, and what makes two configurations the same run.
The files that a run leaves: metrics.json and predictions.npz, or failure.json.
"""

import errno
import io
import json
import logging
import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import lightning as L
import numpy as np
import torch
from filelock import FileLock, Timeout
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch.plugins.environments import SLURMEnvironment
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.strategies.launchers import _SubprocessScriptLauncher
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from cophy.atomic_files import write_atomically
from cophy.bootstrap import Ratio, interval, mean
from cophy.errors import SAFE, CophyError
from cophy.types import Prediction, Targets

log = logging.getLogger(__name__)

Decision = TypeVar("Decision")


def is_first() -> bool:
    """Whether this process decides and writes; the only one does."""
    return getattr(rank_zero_only, "rank", 0) in (0, None)


def plugins() -> list[Any]:
    """Of a Trainer: on a cluster, submitit starts a job again that was stopped; Lightning must not do it, too."""
    return [SLURMEnvironment(auto_requeue=False)] if SLURMEnvironment.detect() else []


def was_queued_again() -> bool:
    """Whether this is a job of a cluster that was stopped before: then it goes on, whatever its command says."""
    return int(os.environ.get("SLURM_RESTART_COUNT", "0")) > 0


def meet(trainer: L.Trainer, module: nn.Module) -> None:
    """Start the processes of the other devices and wait until they are where this one is.

    Args:
        trainer: Of the run.
        module: What is trained.

    Raises:
        CophyError: They cannot be started so, or the module cannot be trained so.
    """
    if trainer.world_size == 1:
        return
    if any(isinstance(part, _BatchNorm) for part in module.modules()):
        raise CophyError(
            "a network with batch normalisation (a de-renderer) needs whole batches: train it on one device"
        )
    strategy = trainer.strategy
    if not isinstance(strategy, DDPStrategy) or not isinstance(strategy.launcher, _SubprocessScriptLauncher):
        raise CophyError("runs on several devices need trainer.strategy=ddp")
    of_a_sweep = HydraConfig.initialized() and HydraConfig.get().mode is RunMode.MULTIRUN
    environment = strategy.cluster_environment
    assert environment is not None
    if of_a_sweep and not environment.creates_processes_externally:
        raise CophyError(
            "a sweep (-m) cannot start runs on several devices by itself: one command for each run, "
            "or hydra/launcher=slurm with hydra.launcher.tasks_per_node= as many as devices"
        )
    os.environ.setdefault("OMP_NUM_THREADS", str(torch.get_num_threads()))  # else Lightning changes their number
    try:
        strategy.launcher.launch(strategy.setup_environment)
    except ValueError as error:  # of Lightning: what was asked for is not what the cluster started
        raise CophyError(f"trainer.devices and hydra.launcher.tasks_per_node: {error}") from error


def first_decides(trainer: L.Trainer, decide: Callable[[], Decision]) -> Decision:
    """What the first process decides, in all of them.

    Args:
        trainer: Whose processes have met.
        decide: Called by the first alone; it may change files.
    """
    if trainer.world_size == 1:
        return decide()
    return trainer.strategy.broadcast(decide() if is_first() else None)  # type: ignore[return-value]


METRICS, PREDICTIONS, FAILURE = "metrics.json", "predictions.npz", "failure.json"  # in the directory of a run
SWEEP = "COPHY_SWEEP"  # variable of the environment: a name for the sweep that a run is of
# keys that change no result: where and how fast it is made, what is shown, and which names a scenario lists
NO_RESULT = {
    *("trainer.accelerator", "trainer.devices", "trainer.num_nodes", "trainer.strategy", "trainer.profiler"),
    *("trainer.enable_progress_bar", "trainer.enable_model_summary", "trainer.log_every_n_steps"),
    *("scenario.task.splits", "render.backend"),
}


@dataclass(frozen=True)
class Run:
    """What train.py does once.

    Attributes:
        scenario, split, model, ablation, positions, seed, size: The names under which it was chosen.
        variant: What it changes beyond its names, for example "+hidden_dim-8"; "" where it changes nothing.
        directory: Where its results go.
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

    def names(self) -> dict[str, Any]:
        """The names alone."""
        return {key: value for key, value in asdict(self).items() if key != "directory"}

    @property
    def place(self) -> Path:
        """The directory's path below the root of all runs (conf/train.yaml, hydra.run.dir)."""
        last = f"seed{self.seed}{self.variant}"
        return Path(self.scenario, self.split, self.model, self.ablation, self.positions, last)

    @property
    def short_name(self) -> str:
        """What tells it from all runs beside it, in one word: its place without what is as usual."""
        usual = {("ablation", "full"), ("positions", "ground_truth")}
        chosen = [(key, getattr(self, key)) for key in ("scenario", "split", "model", "ablation", "positions")]
        return "_".join([*(value for key, value in chosen if (key, value) not in usual), self.place.name])

    @property
    def root(self) -> Path | None:
        """The root of all runs, where the run lies in its place below it."""
        depth = len(self.place.parts)
        return self.directory.parents[depth - 1] if self.directory.parts[-depth:] == self.place.parts else None

    @property
    def checkpoints(self) -> Path:
        """The folder of its checkpoints."""
        return self.directory / "checkpoints"


def differences(key: str, own: Any, expected: Any) -> Iterator[tuple[str, Any]]:
    """The keys that can change a result and whose values are not what is expected, with their own values.

    Args:
        key: Of both, in the whole configuration.
        own: A value, or a dict of them.
        expected: The same of another configuration.
    """
    if isinstance(own, dict) and isinstance(expected, dict):
        for name in sorted(own.keys() | expected.keys()):
            yield from differences(f"{key}.{name}", own.get(name), expected.get(name))
    elif own != expected and key not in NO_RESULT:
        yield key, own


def plain_value(config: DictConfig | ListConfig, key: str) -> Any:
    """What a key of a configuration holds, as dicts, lists and values, enumerations by name."""
    node = OmegaConf.select(config, key)
    return OmegaConf.to_container(node, resolve=True, enum_to_str=True) if OmegaConf.is_config(node) else node


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


class Claim:
    """Of a run's directory, by one process.

    Attributes:
        run: Whose directory it is.
        has_begun: Whether the run got so far that it trains, tests or asks its oracle.
    """

    def __init__(self, run: Run) -> None:
        self.run, self.has_begun = run, False

    def begin(self, *, tests_checkpoint: bool) -> None:
        """Forget earlier results of the run. What is refused before, by a wrong key or missing data, costs none.

        Args:
            tests_checkpoint: Whether it tests a given checkpoint (predictor=). Then the results of a training are left alone.

        Raises:
            CophyError: There are such results.
        """
        if is_first() and tests_checkpoint and _is_of_training(self.run):
            raise CophyError(
                f"{self.run.directory / METRICS} is of a training with these settings: keep the results of predictor= "
                "elsewhere (source.outputs=), or remove it"
            )
        self.has_begun = True
        if is_first():
            forget_results(self.run)


@contextmanager
def claimed(run: Run) -> Iterator[Claim]:
    """The run's directory is this process's, and a failure is noted.

    Raises:
        CophyError: Another process is making this run, or the directory holds the results of another run.
    """
    claim = Claim(run)
    if not is_first():  # the first process claims it for all
        yield claim
        return
    run.directory.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(run.directory / ".lock", timeout=0).acquire()
    except Timeout as error:
        raise CophyError(f"{run.directory}: another process is making this run; wait until it is done") from error
    with lock:
        _check_own(run)
        (run.directory / FAILURE).unlink(missing_ok=True)
        try:
            yield claim
        except Exception as error:
            with suppress(OSError):  # of a full disk
                write_failure(run, error, has_begun=claim.has_begun)
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                raise CophyError(f"no space left for {run.directory}: {SAFE}") from error
            raise


def _is_of_training(run: Run) -> bool:
    try:
        return json.loads((run.directory / METRICS).read_bytes()).get("predictor") is None
    except (FileNotFoundError, ValueError, AttributeError):
        return False


def _check_own(run: Run) -> None:
    path = run.directory / METRICS
    try:
        content = {"variant": "", **json.loads(path.read_bytes())}  # earlier versions did not write it
        others = {key: content[key] for key, value in run.names().items() if content[key] != value}
    except FileNotFoundError:
        return
    except (ValueError, KeyError, TypeError):
        others = {}  # it cannot be said whose: it is of no use to anybody
    if others:
        which = ", ".join(f"{key}={value}" for key, value in others.items())
        raise CophyError(f"{path} is of another run ({which}): choose another hydra.run.dir, or remove it")
