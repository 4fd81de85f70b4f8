"""The best checkpoint of a run."""

from pathlib import Path
from typing import Any

from lightning.pytorch.callbacks import ModelCheckpoint


class BestCheckpoint(ModelCheckpoint):
    """Goes on with the best one so far, also where the run's directory was moved or a longer training has one of its own."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        best = str(Path(self.dirpath or "") / "best.ckpt")
        if Path(best).exists() and state_dict["best_model_path"]:
            scores = dict.fromkeys([best], state_dict["best_model_score"])
            paths = {"dirpath": self.dirpath, "best_model_path": best, "kth_best_model_path": best}
            state_dict = {**state_dict, **paths, "best_k_models": scores}
        super().load_state_dict(state_dict)
