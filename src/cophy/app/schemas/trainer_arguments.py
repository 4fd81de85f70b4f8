"""The arguments of lightning.Trainer that a run may set, and their ranges."""

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING


@dataclass
class TrainerConfig:
    """Arguments of lightning.Trainer that a run may set."""

    max_epochs: int = MISSING
    accelerator: str = MISSING
    devices: Any = MISSING  # a number, "auto" or a list of numbers; such unions OmegaConf 2.3 cannot merge
    precision: str = MISSING
    deterministic: bool = MISSING
    gradient_clip_val: float | None = None
    max_time: str | None = None
    check_val_every_n_epoch: int = 1
    limit_train_batches: Any = None  # a number of batches, or a share; likewise
    limit_val_batches: Any = None  # a number of batches, or a share
    limit_test_batches: Any = None  # a number of batches, or a share
    fast_dev_run: bool = False
    log_every_n_steps: int = 50
    enable_progress_bar: bool = True
    enable_model_summary: bool = True
    num_nodes: int = 1
    strategy: str = "auto"
    profiler: str | None = None

    def __post_init__(self) -> None:
        for key in ("limit_train_batches", "limit_test_batches"):
            if getattr(self, key) == 0:
                raise ValueError(f"trainer.{key}=0: at least one batch is needed")
        if self.max_epochs == 0 or self.max_epochs < -1:
            raise ValueError(f"trainer.max_epochs={self.max_epochs} must be positive, or -1 for no limit")
        if self.check_val_every_n_epoch < 1:
            raise ValueError(f"trainer.check_val_every_n_epoch={self.check_val_every_n_epoch} must be at least 1")

    def check_validates(self) -> None:
        """Refuse a training that is never validated; one that goes on from a checkpoint may have its best from there.

        Raises:
            ValueError: No epoch is validated, or no batch of it.
        """
        every = self.check_val_every_n_epoch
        if self.max_epochs != -1 and every > self.max_epochs:
            raise ValueError(f"trainer.check_val_every_n_epoch={every} must be at most trainer.max_epochs")
        if self.limit_val_batches == 0:
            raise ValueError("trainer.limit_val_batches=0: at least one batch is needed")
