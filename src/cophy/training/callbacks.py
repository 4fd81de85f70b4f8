"""How long a training took, and in a log how far it is.

The checkpoints of a run: the best one, and the last one.
The validation metrics of the best epoch.
How large gradients are.
What happens when a training is stopped.
"""

import logging
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.utilities.exceptions import SIGTERMException
from torch import Tensor
from torch.nn.utils import get_total_norm
from torch.optim import Optimizer

log = logging.getLogger(__name__)


class BestCheckpoint(ModelCheckpoint):
    """Keeps the best checkpoint across resumption, even if the run directory moved.

    Of its state in a checkpoint only the score is restored: the path is always that of this run's best.ckpt.
    """

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        best, score = Path(self.dirpath or "") / "best.ckpt", state_dict.get("best_model_score")
        if best.is_file() and isinstance(score, Tensor) and score.numel() == 1:
            self.best_model_path = self.kth_best_model_path = str(best)
            self.best_model_score = self.kth_value = score
            self.best_k_models = {str(best): score}


class LastCheckpoint(ModelCheckpoint):
    """Keeps the last checkpoint of a run. Nothing is restored: the paths in a checkpoint may be anybody's."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        pass


class BestValidation(L.Callback):
    """Remembers the validation metrics of the epoch with the best val/mse, whose weights are tested.

    Args:
        checkpoint: Of that epoch. Where it is gone, so are its metrics.
    """

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint
        self.metrics: dict[str, float] = {}

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
        if not trainer.sanity_checking and found["val/mse"] < self.metrics.get("val/mse", math.inf):
            self.metrics = found

    def state_dict(self) -> dict[str, Any]:
        return self.metrics

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.metrics = dict(state_dict) if self.checkpoint.exists() else {}


class GradientNorm(L.Callback):
    """Logs the norm of all gradients together before they are clipped, averaged over the steps of an epoch."""

    def on_before_optimizer_step(self, trainer: L.Trainer, pl_module: L.LightningModule, optimizer: Optimizer) -> None:
        norm = get_total_norm([each.grad for each in pl_module.parameters() if each.grad is not None])
        pl_module.log("train/gradient_norm", norm, on_step=False, on_epoch=True, batch_size=1, sync_dist=True)


class StopTogether(L.Callback):
    """How SIGTERM ends a training: on one device as Lightning does, on several in all processes after the same batch.

    Lightning's own handler makes the processes meet wherever the signal finds them; one may be inside another meeting.
    On a cluster, submitit ignores SIGTERM and waits for the signal that queues the job again: that stays so.
    """

    def __init__(self) -> None:
        self.of_submitit = signal.getsignal(signal.SIGTERM) if "SUBMITIT_EXECUTOR" in os.environ else None
        self.asked = False

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if self.of_submitit is not None:
            signal.signal(signal.SIGTERM, self.of_submitit)
        elif trainer.world_size > 1:
            signal.signal(signal.SIGTERM, lambda signum, frame: setattr(self, "asked", True))

    def on_train_batch_start(
        self, trainer: L.Trainer, pl_module: L.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        if trainer.world_size > 1 and trainer.strategy.reduce_boolean_decision(self.asked, all=False):
            raise SIGTERMException


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: the same command goes on from %s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)


TOLD_EVERY_S = 30.0  # ours: a log of minutes or hours stays readable


class Stopwatch(L.Callback):
    """Counts the seconds of a training, those before it was stopped included. Where no bar is seen, it logs the progress.

    Args:
        title: Of the run, for the log.
    """

    def __init__(self, title: str) -> None:
        self.title, self._before, self._start = title, 0.0, time.monotonic()
        self._told = self._start

    @property
    def seconds(self) -> float:
        """So far."""
        return self._before + time.monotonic() - self._start

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._start = time.monotonic()

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        has_bar = trainer.progress_bar_callback is not None and sys.stdout.isatty()
        if has_bar or not trainer.is_global_zero or time.monotonic() - self._told < TOLD_EVERY_S:
            return
        self._told = time.monotonic()
        last = f" of {trainer.max_epochs}" if (trainer.max_epochs or -1) > 0 else ""
        mse = float(trainer.callback_metrics.get("val/mse", float("nan")))
        done = trainer.current_epoch + 1
        log.info("%s: epoch %d%s, val/mse %.4f, %.0f s", self.title, done, last, mse, self.seconds)

    def state_dict(self) -> dict[str, Any]:
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._before = state_dict["seconds"]
