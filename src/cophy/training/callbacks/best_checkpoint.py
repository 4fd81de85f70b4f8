"""The checkpoints of a run: the best one, and the last one."""

from pathlib import Path
from typing import Any

from lightning.pytorch.callbacks import ModelCheckpoint
from torch import Tensor


class BestCheckpoint(ModelCheckpoint):
    """Keeps the best checkpoint across resumption, even if the run directory moved.

    Of its state in a checkpoint only the score is restored: the path is always that of this run's best.ckpt.
    """

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        best, score = Path(self.dirpath or "") / "best.ckpt", state_dict.get("best_model_score")
        if best.is_file() and isinstance(score, Tensor) and score.numel() == 1:
            self.best_model_path = self.kth_best_model_path = str(best)
            self.best_model_score = self.kth_value = score
            self.best_k_models = {str(best): score}


class LastCheckpoint(ModelCheckpoint):
    """Keeps the last checkpoint of a run. Nothing is restored: the paths in a checkpoint may be anybody's."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        pass
