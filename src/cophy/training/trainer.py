"""Lightning's Trainer as every run uses it: callbacks, loggers, checkpoints, devices.

On several devices there is one process per device, started by Lightning or SLURM (docs/guides/clusters.md), and each runs the whole
command. The first process decides and writes.
"""

import os
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import lightning as L
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.accelerators import CPUAccelerator
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint, Timer
from lightning.pytorch.loggers import Logger
from lightning.pytorch.plugins.environments import SLURMEnvironment
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.strategies.launchers import _SubprocessScriptLauncher
from lightning.pytorch.utilities.exceptions import SIGTERMException
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from cophy.drawing.tensorboard import Curves
from cophy.errors import CophyError
from cophy.training.callbacks import (
    BestValidation,
    GradientNorm,
    NetworkSize,
    ResumeHint,
    StopTogether,
    Stopwatch,
)
from cophy.training.checkpoints import LOADING_ERRORS, WholeCheckpoints, misfit
from cophy.training.instantiation import instantiate_key
from cophy.training.reuse import Start
from cophy.training.run import Run, flatten, is_rank_zero

MAX_PROCESSES_PER_CORE = 8  # of a run on CPUs; more would only fill the memory

# the whole dataset is in memory and is sliced: Lightning's advice to add workers does not apply
warnings.filterwarnings("ignore", ".*does not have many workers.*")
warnings.filterwarnings("ignore", "The `srun` command is available.*")  # runs on a cluster are started by submitit
warnings.filterwarnings("ignore", "Checkpoint directory .* exists and is not empty")  # it is the run's own
warnings.filterwarnings("ignore", ".*LeafSpec.*")  # Lightning 2.6 with torch 2.13

Decision = TypeVar("Decision")


def make_trainer(
    run: Run,
    origin: dict[str, Any],
    figures: L.Callback,
    *,
    loggers: dict[str, Any],
    arguments: dict[str, Any],
    optimized_metric: str,
) -> L.Trainer:
    """Build a Trainer that keeps the weights with the smallest validation MSE, and the last checkpoint for resuming.

    Args:
        origin: The configuration that every checkpoint stores.
        figures: Callback that draws validation examples.
        loggers: `_target_` and arguments of each logger (conf/logger).
        arguments: Arguments of `lightning.Trainer` (conf/trainer).
        optimized_metric: What a sweep optimises, refused if validation does not have it.

    Raises:
        CophyError: A logger or callback cannot be built, Lightning refuses an argument, or on SLURM it would continue from a
            file that train.py did not write.
    """
    built_loggers = [
        instantiate_key(f"logger={name}", keys, **_log_directory(run, keys)) for name, keys in loggers.items()
    ]
    best = ModelCheckpoint(
        run.checkpoints, filename="best", monitor="val/mse", save_weights_only=True, enable_version_counter=False
    )
    # A callback of its own: with save_last=True Lightning 2.6 writes the last checkpoint only when it is the best.
    # It is written after every epoch, also if validation is rarer.
    last = ModelCheckpoint(run.checkpoints, filename="last", enable_version_counter=False, save_on_train_epoch_end=True)
    callbacks = [
        *(best, last, StopTogether()),
        *([LearningRateMonitor("epoch")] if loggers else []),
        *(GradientNorm(), figures, BestValidation(best, optimized_metric), Stopwatch(str(run.place))),
        *(instantiate_key(f"callbacks={name}", keys) for name, keys in origin["training"]["callbacks"].items()),
        ResumeHint(run.checkpoints / "last.ckpt"),
        *([NetworkSize()] if arguments["enable_model_summary"] else []),
    ]
    # submitit requeues preempted jobs, so Lightning must not
    slurm = [SLURMEnvironment(auto_requeue=False)] if SLURMEnvironment.detect() else []
    if slurm and (names := sorted(run.directory.glob("hpc_ckpt_*"))):
        raise CophyError(f"{names[0]}: Lightning would continue from it, but train.py writes no such file: delete it")
    states = {each.state_key for each in callbacks if not isinstance(each, ModelCheckpoint)}
    states.add(Timer.__qualname__)  # which Lightning adds for trainer.max_time
    try:
        trainer = L.Trainer(
            logger=built_loggers,
            callbacks=callbacks,
            default_root_dir=run.directory,
            plugins=[WholeCheckpoints(origin, run.checkpoints, states), *slurm],
            use_distributed_sampler=False,  # the datamodules share batches among devices themselves
            **arguments,
        )
    except (TypeError, ValueError, RuntimeError, MisconfigurationException) as error:  # it takes nothing but arguments
        raise CophyError(f"trainer: {error}") from error
    if trainer.accumulate_grad_batches < 1:
        raise CophyError(f"trainer.accumulate_grad_batches={trainer.accumulate_grad_batches} must be at least 1")
    cores = os.cpu_count() or 1
    if isinstance(trainer.accelerator, CPUAccelerator) and trainer.num_devices > MAX_PROCESSES_PER_CORE * cores:
        raise CophyError(f"trainer.devices={trainer.num_devices} starts as many processes, but there are {cores} cores")
    if trainer.world_size > 1 and arguments.get("limit_test_batches") is not None:
        raise CophyError("trainer.limit_test_batches= needs trainer.devices=1: each device has other experiments")
    return trainer


def fit(
    trainer: L.Trainer, module: L.LightningModule, data: L.LightningDataModule, ckpt: Path | None
) -> dict[str, Any]:
    """Train, and return training_seconds, training_cpu_seconds and the validation metrics of the best epoch.

    Raises:
        CophyError: Lightning refuses a combination of arguments, the checkpoint does not fit, or the training diverges.
        SystemExit: The process was asked to end (SIGTERM).
    """
    try:
        with reporting(trainer, ckpt):
            trainer.fit(module, data, ckpt_path=ckpt, weights_only=True)
    except torch.linalg.LinAlgError as error:  # SOAP's
        raise CophyError(
            f"training: gradients are too large for the optimizer, lower learning_rate ({error})"
        ) from error
    except SIGTERMException as error:
        # exit code of a process that SIGTERM ended; on several devices, Lightning kills the first if another one fails
        raise SystemExit(128 + signal.SIGTERM if is_rank_zero() else 0) from error
    callbacks: list[L.Callback] = trainer.callbacks  # type: ignore[attr-defined]
    (stopwatch,) = (each for each in callbacks if isinstance(each, Stopwatch))
    (best,) = (each for each in callbacks if isinstance(each, BestValidation))
    seconds = {"training_seconds": round(stopwatch.seconds, 1), "training_cpu_seconds": round(stopwatch.cpu_seconds, 1)}
    return {**seconds, "validation": best.metrics}


@contextmanager
def reporting(trainer: L.Trainer, ckpt: Path | None) -> Iterator[None]:
    """Report what Lightning refuses as an error of the trainer's arguments, or of the checkpoint that it restores."""
    try:
        yield
    except MisconfigurationException as error:
        raise CophyError(f"trainer: {error}") from error
    except LOADING_ERRORS as error:
        if ckpt is None or not trainer._checkpoint_connector._loaded_checkpoint:  # kept until all is restored
            raise
        raise misfit(ckpt, error) from error


def check_devices(trainer: L.Trainer, module: nn.Module) -> None:
    """Check whether a module can be trained on the devices of a trainer, before data are generated.

    Raises:
        CophyError: It needs whole batches, or processes for several devices cannot be started this way.
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
    is_sweep = HydraConfig.initialized() and HydraConfig.get().mode is RunMode.MULTIRUN
    environment = strategy.cluster_environment
    assert environment is not None
    if is_sweep and not environment.creates_processes_externally:
        raise CophyError(
            "a sweep (-m) cannot start runs on several devices by itself: use one command for each run, "
            "or hydra/launcher=slurm with hydra.launcher.tasks_per_node= as many as devices"
        )


def start_processes(trainer: L.Trainer) -> None:
    """Start the processes of the other devices, if any, and wait until they have come as far as this one.

    Raises:
        CophyError: A cluster started another number of processes.
    """
    if trainer.world_size == 1:
        return
    strategy = trainer.strategy
    assert strategy.launcher is not None  # see `check_devices`
    os.environ.setdefault("OMP_NUM_THREADS", str(torch.get_num_threads()))  # otherwise Lightning changes it
    try:
        strategy.launcher.launch(strategy.setup_environment)
    except ValueError as error:  # Lightning: the cluster started another number of processes
        raise CophyError(f"trainer.devices and hydra.launcher.tasks_per_node: {error}") from error


def decide_first(trainer: L.Trainer, decide: Callable[[], Decision]) -> Decision:
    """Call a function in the first process alone, and return its result in all of them."""
    return trainer.strategy.broadcast(decide() if trainer.is_global_zero else None)  # type: ignore[return-value]


def was_requeued() -> bool:
    """Return whether this is a job of a cluster that was stopped before: it continues, whatever its command says."""
    return int(os.environ.get("SLURM_RESTART_COUNT", "0")) > 0


def prepare_loggers(
    trainer: L.Trainer, run: Run, origin: dict[str, Any], arguments: dict[str, Any], start: Start
) -> None:
    """Remove TensorBoard's curves of an earlier training, and log what loggers compare runs by.

    Args:
        trainer: Its loggers are prepared.
        origin: Keys of model and training.
        start: Whether earlier curves belong to this training. If the run only tests, nothing is added to curves that stay.
    """
    for logger in trainer.loggers if trainer.is_global_zero and not start.keeps_curves else []:
        if isinstance(logger, Curves):
            logger.remove_earlier()
    if start.finished is not None:
        trainer.loggers = [each for each in trainer.loggers if not (isinstance(each, Curves) and each.earlier)]
    keys = {"model": origin["model"], "training": origin["training"], "trainer": arguments}
    for logger in trainer.loggers:
        logger.log_hyperparams(run.names() | flatten(keys))


def log_results(trainer: L.Trainer, results: dict[str, float]) -> None:
    """Log the mean of every metric on the test split."""
    for logger in trainer.loggers:
        if isinstance(logger, Curves):
            logger.log_results(results, trainer.global_step)
        else:
            logger.log_metrics({f"test/{name}": value for name, value in results.items()}, trainer.global_step)
        logger.save()


@contextmanager
def finishing(loggers: list[Logger]) -> Iterator[None]:
    """Finish all loggers at the end, even if the run fails: W&B would add the next run of a sweep to this one."""
    try:
        yield
    finally:
        for logger in loggers:
            # not the property `experiment`, which would create one
            if finish := getattr(getattr(logger, "_experiment", None), "finish", None):
                finish()


def _log_directory(run: Run, arguments: dict[str, Any]) -> dict[str, str]:
    """Return where a logger writes: the run's directory; for curves, which TensorBoard names by folder, the root."""
    if run.root is not None and arguments.get("_target_") == f"{Curves.__module__}.{Curves.__name__}":
        return {"save_dir": str(run.root), "name": f"{arguments['name']}/{run.short_name}"}
    return {"save_dir": str(run.directory)}
