"""What happens when a training is stopped."""

import logging
import os
import signal
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.utilities.exceptions import SIGTERMException

log = logging.getLogger(__name__)


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
