"""How every network is optimised: by what `optimizer=` and `schedule=` choose (conf/optimizer, conf/schedule).

How predictors are trained (`training` in conf/train.yaml).
"""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import lightning as L
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from cophy.errors import CophyError


class Augmentation(Enum):
    """Into what training experiments are turned: nothing else, others that are as likely, or any of the same physics."""

    none = "none"
    symmetries = "symmetries"
    physics = "physics"


@dataclass
class Training:
    """How a network is optimised; each value's source is in the YAML.

    position_noise: largest standard deviation by which positions of AB and C are off in training, metres; see
        `cophy.training.augmentation.disturb`.
    num_experiments: so many training experiments are used, the first ones; None for all.
    optimizer, schedule, callbacks: a `_target_` and its arguments each, as their groups of conf/ choose.
    """

    batch_size: int
    learning_rate: float
    augmentation: Augmentation
    position_noise: float
    position_weight: float
    stability_weight: float
    confounder_weight: float
    num_experiments: int | None = None
    optimizer: dict[str, Any] = field(default_factory=dict)
    schedule: dict[str, Any] = field(default_factory=dict)
    callbacks: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        weights = {name: getattr(self, f"{name}_weight") for name in ("position", "stability", "confounder")}
        if self.batch_size < 1 or self.learning_rate <= 0 or min(self.position_noise, *weights.values()) < 0:
            raise ValueError(
                "training: batch_size and learning_rate must be positive, noise and weights not negative: "
                f"batch_size={self.batch_size}, learning_rate={self.learning_rate}, "
                f"position_noise={self.position_noise}, weights {weights}"
            )
        if self.num_experiments is not None and self.num_experiments < 1:
            raise ValueError(f"training.num_experiments={self.num_experiments} must be at least 1")


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
