"""Lightning's Trainer as every run uses it: TensorBoard, the best and the last checkpoint, figures."""

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import lightning as L
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.accelerators import CPUAccelerator
from lightning.pytorch.callbacks import LearningRateMonitor, ModelSummary
from lightning.pytorch.loggers import Logger

from cophy.errors import CophyError
from cophy.training.callbacks import BestCheckpoint, GradientNorm, LastCheckpoint, ResumeHint, StopTogether
from cophy.training.checkpoints import Origin, WholeCheckpoints
from cophy.training.figures import Curves
from cophy.training.run import Run, plugins

log = logging.getLogger(__name__)

MOST_PER_CORE = 8  # processes of a run on CPUs; more would only fill the memory

# the whole data set lies in memory and is sliced: Lightning's advice to add workers does not apply
warnings.filterwarnings("ignore", ".*does not have many workers.*")
warnings.filterwarnings("ignore", "The `srun` command is available.*")  # runs on a cluster are started by submitit
warnings.filterwarnings("ignore", "Checkpoint directory .* exists and is not empty")  # it is the run's own
warnings.filterwarnings("ignore", ".*LeafSpec.*")  # of Lightning 2.6 with torch 2.13, nothing a user can do


class Size(ModelSummary):
    """Say how large the network is, in one line; Lightning's table counts "0 FLOPs" besides."""

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.is_global_zero:
            count = sum(each.numel() for each in pl_module.parameters() if each.requires_grad)
            log.info("%s: %s parameters are trained", type(pl_module.network).__name__, f"{count:,}")


def loggers_of(run: Run, chosen: dict[str, Any]) -> list[Logger]:
    """Where curves, figures and final metrics go.

    Args:
        run: They go below its directory, unless a logger has a server; curves into a folder of all runs, see `_place`.
        chosen: By `logger=`: a `_target_` and its arguments each (conf/logger).
    """
    return [_made(f"logger={name}", arguments, **_place(run, arguments)) for name, arguments in chosen.items()]


def _place(run: Run, arguments: dict[str, Any]) -> dict[str, str]:
    """Where a logger's files go: into the run's directory, but for curves, which TensorBoard names by their folder."""
    if run.root is not None and arguments.get("_target_") == f"{Curves.__module__}.{Curves.__name__}":
        return {"save_dir": str(run.root), "name": f"{arguments['name']}/{run.short_name}"}
    return {"save_dir": str(run.directory)}


def forget_curves(trainer: L.Trainer) -> None:
    """Before a training begins anew: remove TensorBoard's curves of an earlier one of the same run."""
    for logger in trainer.loggers if trainer.is_global_zero else []:
        if isinstance(logger, Curves):
            logger.forget_earlier()


def log_results(loggers: list[Logger], results: dict[str, float], step: int) -> None:
    """Send what the test measured.

    Args:
        loggers: Where to.
        results: Each measure's mean.
        step: Of the training.
    """
    for logger in loggers:
        if isinstance(logger, Curves):
            logger.log_results(results, step)
        else:
            logger.log_metrics({f"test/{name}": value for name, value in results.items()}, step)
        logger.save()


@contextmanager
def finishing(loggers: list[Logger]) -> Iterator[None]:
    """Ends what the loggers began, also where the run fails: W&B would put the next run of a sweep into this one."""
    try:
        yield
    finally:
        for logger in loggers:
            if isinstance(logger, Curves):  # to ask for its writer would make a file
                continue
            if finish := getattr(getattr(logger, "experiment", None), "finish", None):
                finish()


def with_epochs(arguments: dict[str, Any], factor: int) -> dict[str, Any]:
    """The arguments, with so many times as many epochs; no limit stays none."""
    return arguments | {"max_epochs": max(factor * arguments["max_epochs"], -1)}


def make_trainer(
    run: Run, origin: Origin, watching: list[L.Callback], loggers: list[Logger], arguments: dict[str, Any]
) -> L.Trainer:
    """A Trainer that keeps the weights with the smallest validation MSE, and the last checkpoint, to go on from.

    Args:
        run: Says where everything goes.
        origin: Goes into every checkpoint.
        watching: Callbacks of this run: what draws, and what remembers.
        loggers: Where it logs.
        arguments: Of `lightning.Trainer` (conf/trainer/).
    """
    callbacks = [
        BestCheckpoint(
            run.checkpoints, filename="best", monitor="val/mse", save_weights_only=True, enable_version_counter=False
        ),
        # The last has a callback of its own: with save_last=True Lightning 2.6 writes it only when it is the best.
        # It is written after every epoch, also where validation is rarer.
        LastCheckpoint(run.checkpoints, filename="last", enable_version_counter=False, save_on_train_epoch_end=True),
        StopTogether(),
        *([LearningRateMonitor("epoch")] if loggers else []),
        GradientNorm(),
        *watching,
        *(_made(f"callbacks={name}", each) for name, each in origin.training["callbacks"].items()),
        ResumeHint(run.checkpoints / "last.ckpt"),
        *([Size()] if arguments["enable_model_summary"] else []),
    ]
    with _explained():
        return L.Trainer(
            logger=loggers,
            callbacks=callbacks,
            default_root_dir=run.directory,
            plugins=[WholeCheckpoints(origin, run.checkpoints), *plugins()],
            use_distributed_sampler=False,  # the datamodules share batches among devices themselves
            **arguments,
        )


def check_arguments(arguments: dict[str, Any]) -> None:
    """Refuse what Lightning's Trainer does not take, before data are made.

    Raises:
        CophyError: Says which argument, as Lightning does.
    """
    said = [logging.getLogger(f"lightning.{part}") for part in ("pytorch", "fabric")]
    levels = [each.level for each in said]
    for each in said:  # what it says of devices, it says again when the run has its Trainer
        each.setLevel(logging.ERROR)
    try:
        with _explained(), warnings.catch_warnings(action="ignore"):
            made = L.Trainer(logger=False, enable_checkpointing=False, **arguments)
        cores = os.cpu_count() or 1
        if isinstance(made.accelerator, CPUAccelerator) and made.num_devices > MOST_PER_CORE * cores:
            raise CophyError(f"trainer.devices={made.num_devices} starts as many processes; here are {cores} cores")
    finally:
        for each, level in zip(said, levels, strict=True):
            each.setLevel(level)


@contextmanager
def _explained() -> Iterator[None]:
    """What is wrong with a Trainer's arguments is the user's to mend."""
    try:
        yield
    except (TypeError, ValueError, RuntimeError, MisconfigurationException) as error:
        raise CophyError(f"trainer: {error}") from error


def _made(key: str, arguments: dict[str, Any], **more: Any) -> Any:
    """What `_target_` names."""
    try:
        return instantiate(arguments, **more)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ModuleNotFoundError):
            raise CophyError(f"{key} needs another package: {cause}") from error
        raise CophyError(f"{key}: {cause or error}") from error
