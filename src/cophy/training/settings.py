"""The keys below `training` in conf/train.yaml. No torch here: `--help` imports this file."""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

MAX_LEARNING_RATE = 1e6  # ours: nothing is trained with this; PyTorch's optimisers fail beyond single precision


class Augmentation(Enum):
    """How training experiments are turned: not at all, into equally likely ones, or into any that obey the same physics."""

    none = "none"
    symmetries = "symmetries"
    physics = "physics"


@dataclass
class Training:
    """How a network is trained; the source of each default is in the YAML.

    Attributes:
        position_noise: Largest standard deviation of the noise on positions of AB and C in training, metres; see
            `cophy.training.augmentation.add_position_noise`.
        num_experiments: Use only the first so many training experiments; None for all.
        loss, optimizer, schedule, callbacks: `_target_` and arguments, as the files in conf/loss, conf/optimizer and so on set
            them.
    """

    batch_size: int
    learning_rate: float
    augmentation: Augmentation
    position_noise: float
    position_weight: float
    stability_weight: float
    confounder_weight: float
    num_experiments: int | None = None
    loss: dict[str, Any] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    schedule: dict[str, Any] = field(default_factory=dict)
    callbacks: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        weights = {name: getattr(self, f"{name}_weight") for name in ("position", "stability", "confounder")}
        not_negative = all(0 <= value < math.inf for value in (self.position_noise, *weights.values()))
        if self.batch_size < 1 or not 0 < self.learning_rate <= MAX_LEARNING_RATE or not not_negative:
            raise ValueError(
                f"training: batch_size and learning_rate must be positive, the latter at most {MAX_LEARNING_RATE:g}, "
                "noise and weights not negative: "
                f"batch_size={self.batch_size}, learning_rate={self.learning_rate}, "
                f"position_noise={self.position_noise}, weights {weights}"
            )
        if self.num_experiments is not None and self.num_experiments < 1:
            raise ValueError(f"training.num_experiments={self.num_experiments} must be at least 1")
