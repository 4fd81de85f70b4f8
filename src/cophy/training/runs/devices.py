"""Runs on several devices: a process for each. The first decides and writes, the others compute along.

Lightning starts the other processes, or SLURM has (docs/sweeps.md). Every process runs the whole command.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar

import lightning as L
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch.plugins.environments import SLURMEnvironment
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.strategies.launchers import _SubprocessScriptLauncher
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from cophy.errors import CophyError

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
