"""The validation metrics of the best epoch."""

import math
from pathlib import Path
from typing import Any

import lightning as L


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
