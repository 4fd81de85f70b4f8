"""How long a training took, and in a log how far it is."""

import logging
import sys
import time
from typing import Any

import lightning as L

log = logging.getLogger(__name__)

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
