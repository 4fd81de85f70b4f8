"""What happens when a training is stopped."""

import logging
import os
import signal
from pathlib import Path

import lightning as L

log = logging.getLogger(__name__)


class SubmititsSignals(L.Callback):
    """On a cluster, submitit ignores SIGTERM and waits for the signal that queues the job again; Lightning would end it."""

    def __init__(self) -> None:
        self.of_submitit = signal.getsignal(signal.SIGTERM) if "SUBMITIT_EXECUTOR" in os.environ else None

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if self.of_submitit is not None:
            signal.signal(signal.SIGTERM, self.of_submitit)


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: the same command goes on from %s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)
