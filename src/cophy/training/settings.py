"""How predictors are trained (`training` in conf/train.yaml)."""

from dataclasses import dataclass


@dataclass
class Training:
    """Optimisation with Adam; each value's source is in the YAML."""

    batch_size: int
    learning_rate: float
    augmentation: bool
    position_weight: float
    stability_weight: float
    confounder_weight: float

    def __post_init__(self) -> None:
        weights = (self.position_weight, self.stability_weight, self.confounder_weight)
        if self.batch_size < 1 or self.learning_rate <= 0 or min(weights) < 0:
            raise ValueError(f"training: batch_size and learning_rate must be positive, weights not negative: {self}")
