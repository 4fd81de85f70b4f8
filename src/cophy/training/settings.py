"""How predictors are trained (`training` in conf/train.yaml)."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Any


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
