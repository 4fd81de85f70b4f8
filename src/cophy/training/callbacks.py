"""Callbacks of a training: checkpoints, best validation metrics, gradient norm, progress, what happens when it is stopped."""

import logging
import math
import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, ModelSummary
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities.exceptions import SIGTERMException
from torch.nn.utils import get_total_norm
from torch.optim import Optimizer

from cophy.errors import CophyError

log = logging.getLogger(__name__)

LOG_EVERY_S = 30.0  # ours: the log of a training of minutes or hours stays readable


def check_optimized(name: str, metrics: Mapping[str, float]) -> None:
    """Refuse optimized_metric= if it is no metric of validation."""
    if name not in metrics:
        raise CophyError(f"optimized_metric={name} is not among {', '.join(sorted(metrics))}")


class BestValidation(L.Callback):
    """Keeps the validation metrics of the epoch with the best val/mse, across resumption, even if the run directory moved.

    Args:
        checkpoint: Saves the weights of that epoch as best.ckpt. Its own state, which names paths, is never restored: it
            continues from these metrics if this run has that file.
        needed: The metric that a sweep optimises.
    """

    def __init__(self, checkpoint: ModelCheckpoint, needed: str) -> None:
        self.checkpoint, self.needed = checkpoint, needed
        self.metrics: dict[str, float] = {}

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
        if trainer.sanity_checking or not metrics:  # oracles have none
            return
        check_optimized(self.needed, metrics)
        if metrics.get("val/mse", math.inf) < self.metrics.get("val/mse", math.inf):
            self.metrics = metrics

    def state_dict(self) -> dict[str, Any]:
        return self.metrics

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        saver = self.checkpoint
        path = Path(saver.dirpath or "", "best.ckpt")
        if path.is_file():
            self.metrics = {name: float(value) for name, value in state_dict.items()}
            score = torch.tensor(self.metrics["val/mse"], dtype=torch.float64)
            saver.best_model_path = saver.kth_best_model_path = str(path)
            saver.best_model_score = saver.kth_value = score
            saver.best_k_models = {str(path): score}


class GradientNorm(L.Callback):
    """Logs the total norm of all gradients before clipping, averaged over the steps of an epoch."""

    def on_before_optimizer_step(self, trainer: L.Trainer, pl_module: L.LightningModule, optimizer: Optimizer) -> None:
        norm = get_total_norm([each.grad for each in pl_module.parameters() if each.grad is not None])
        pl_module.log("train/gradient_norm", norm, on_step=False, on_epoch=True, batch_size=1, sync_dist=True)


class NetworkSize(ModelSummary):
    """Logs the number of trained parameters in one line."""

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.is_global_zero:
            count = sum(each.numel() for each in pl_module.parameters() if each.requires_grad)
            log.info("%s: %s trainable parameters", type(pl_module.network).__name__, f"{count:,}")


class StopTogether(L.Callback):
    """On SIGTERM, ends training on several devices in all processes after the same batch, and a test at once.

    Lightning's own handler synchronises the processes wherever the signal arrives, perhaps inside another synchronisation.
    On one device Lightning's handler stays in training, but not in tests: it waits for the end of the batch, in which oracles
    simulate for hours. On a cluster, submitit's stays: it ignores SIGTERM and waits for the signal that requeues the job.
    """

    def __init__(self) -> None:
        self.submitit_handler = signal.getsignal(signal.SIGTERM) if "SUBMITIT_EXECUTOR" in os.environ else None
        self.received = False

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if self.submitit_handler is not None:
            signal.signal(signal.SIGTERM, self.submitit_handler)
        elif trainer.world_size > 1:
            signal.signal(signal.SIGTERM, lambda signum, frame: setattr(self, "received", True))

    def on_test_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        signal.signal(signal.SIGTERM, self.submitit_handler or signal.SIG_DFL)  # Lightning restores handlers at the end

    def on_train_batch_start(
        self, trainer: L.Trainer, pl_module: L.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        if trainer.world_size > 1 and trainer.strategy.reduce_boolean_decision(self.received, all=False):
            raise SIGTERMException


class ResumeHint(L.Callback):
    """Logs how to continue when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if trainer.state.fn != TrainerFn.FITTING:  # a test
            return
        if self.checkpoint.exists():
            log.warning(
                "stopped in epoch %d: run the same command to continue from %s", trainer.current_epoch, self.checkpoint
            )
        elif not isinstance(exception, CophyError):  # whose one line says what to do
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)


class Stopwatch(L.Callback):
    """Measures the seconds and CPU seconds of a training across resumption, and logs progress if there is no progress bar.

    Args:
        title: The run's name in the log.
    """

    def __init__(self, title: str) -> None:
        self.title, self._before, self._cpu_before = title, 0.0, 0.0
        self._start, self._cpu_start = time.monotonic(), time.process_time()
        self._last_log = self._start

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return self._before + time.monotonic() - self._start

    @property
    def cpu_seconds(self) -> float:
        """CPU seconds of this process so far, over all its threads."""
        return self._cpu_before + time.process_time() - self._cpu_start

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._start, self._cpu_start = time.monotonic(), time.process_time()

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        has_bar = trainer.progress_bar_callback is not None and sys.stdout.isatty()
        if has_bar or not trainer.is_global_zero or time.monotonic() - self._last_log < LOG_EVERY_S:
            return
        self._last_log = time.monotonic()
        total = f" of {trainer.max_epochs}" if (trainer.max_epochs or -1) > 0 else ""
        mse = float(trainer.callback_metrics.get("val/mse", float("nan")))
        epoch = trainer.current_epoch + 1
        log.info("%s: epoch %d%s, val/mse %.4f, %.0f s", self.title, epoch, total, mse, self.seconds)

    def state_dict(self) -> dict[str, Any]:
        return {"seconds": self.seconds, "cpu_seconds": self.cpu_seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._before, self._cpu_before = float(state_dict["seconds"]), float(state_dict["cpu_seconds"])
