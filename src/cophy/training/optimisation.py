"""The optimiser and its learning rate over time, as conf/optimizer and conf/schedule choose them."""

import math
from typing import Any

import lightning as L
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from cophy.errors import CophyError
from cophy.training.settings import Training


def make_optimizer(module: L.LightningModule, training: Training) -> OptimizerLRScheduler:
    """Return the optimiser of a module's parameters and its schedule, stepped once per epoch.

    Args:
        module: Attached to a Trainer; its `max_epochs` is an argument of the schedule.
        training: `optimizer` is called with the parameters, `schedule` with the optimiser and the number of epochs (-1: no limit).
    """
    try:
        optimizer = instantiate(training.optimizer)(module.parameters())
        schedule = instantiate(training.schedule)(optimizer, module.trainer.max_epochs)
    except (InstantiationException, TypeError, ValueError) as error:
        hint = "; their YAML has _partial_: true" if "missing" in str(error) else ""
        raise CophyError(f"training.optimizer or training.schedule: {error.__cause__ or error}{hint}") from error
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}


class Annealing(LambdaLR):
    """LambdaLR that keeps its own schedule when a longer training resumes from the checkpoint of a shorter one."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue at an epoch with this schedule's rate instead of the one stored with the optimiser."""
        super().load_state_dict(state_dict)
        for group, rate, factor in zip(self.optimizer.param_groups, self.base_lrs, self.lr_lambdas, strict=True):
            group["lr"] = rate * factor(self.last_epoch)


def cosine_to_zero(optimizer: Optimizer, epochs: int) -> LambdaLR:
    """Let the learning rate fall to zero along a cosine."""
    if epochs < 1:  # -1: no limit
        raise ValueError(
            f"trainer.max_epochs={epochs} has no last epoch, where the rate is zero: add schedule=constant"
        )
    return Annealing(optimizer, lambda epoch: (1 + math.cos(math.pi * min(epoch / epochs, 1))) / 2)


def constant(optimizer: Optimizer, epochs: int) -> LambdaLR:
    """Keep the learning rate constant."""
    return LambdaLR(optimizer, lambda epoch: 1.0)
