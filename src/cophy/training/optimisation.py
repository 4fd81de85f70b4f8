"""How every network is optimised."""

import math

import lightning as L
import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch.optim.lr_scheduler import LambdaLR


def adam_with_cosine(module: L.LightningModule, learning_rate: float) -> OptimizerLRScheduler:
    """Adam, its learning rate falling to zero along a cosine over the epochs of the run (also of a longer resumed one)."""
    optimizer = torch.optim.Adam(module.parameters(), lr=learning_rate)
    epochs = max(module.trainer.max_epochs or 1, 1)
    schedule = LambdaLR(optimizer, lambda epoch: (1 + math.cos(math.pi * min(epoch / epochs, 1))) / 2)
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}
