"""How every network is optimised: by what `optimizer=` and `schedule=` choose (conf/optimizer, conf/schedule)."""

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


def optimisation(module: L.LightningModule, training: Training) -> OptimizerLRScheduler:
    """The optimiser of a module's parameters, and how its learning rate changes from epoch to epoch.

    Args:
        module: Attached to the Trainer that says for how many epochs it is trained.
        training: `optimizer` is called with the parameters, `schedule` with the optimiser and the number of epochs.
    """
    try:
        optimizer = instantiate(training.optimizer)(module.parameters())
        schedule = instantiate(training.schedule)(optimizer, max(module.trainer.max_epochs or 1, 1))
    except (InstantiationException, TypeError, ValueError) as error:
        raise CophyError(f"training.optimizer or training.schedule: {error.__cause__ or error}") from error
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}


class Annealing(LambdaLR):
    """Its rate follows its own schedule also where a longer training goes on from a checkpoint of a shorter one."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on at an epoch. The optimiser's rate, of the shorter training, is replaced by that of this one."""
        super().load_state_dict(state_dict)
        for group, rate, factor in zip(self.optimizer.param_groups, self.base_lrs, self.lr_lambdas, strict=True):
            group["lr"] = rate * factor(self.last_epoch)


def cosine_to_zero(optimizer: Optimizer, epochs: int) -> LambdaLR:
    """Falls to zero along a cosine. A longer training may go on from a checkpoint of a shorter one."""
    return Annealing(optimizer, lambda epoch: (1 + math.cos(math.pi * min(epoch / epochs, 1))) / 2)


def constant(optimizer: Optimizer, epochs: int) -> LambdaLR:
    """Stays what it is."""
    return LambdaLR(optimizer, lambda epoch: 1.0)
