"""How TensorBoard names runs and values: results first, nothing that is constant."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import TensorBoardLogger

# TensorBoard has a card for each value, in the order of their names: with these, the first ones are results
RENAMED = {"val/mse": "mse/val", "test/mse": "mse/test"}
OF_CELL = "val/mse_"
CONSTANT = {"epoch", "train/stability_base_rate", "val/stability_base_rate"}  # a curve of these says nothing
COMPARED = ("mse", "twin_difference_explained", "right_twin_chosen", "sequence_stability_accuracy")  # of the test


class Curves(TensorBoardLogger):
    """Lightning's logger for TensorBoard, with cards in the order of what matters.

    Attributes:
        earlier: What lies in its folder already: curves of an earlier training of the same run.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.earlier = sorted(Path(self.log_dir).rglob("events.out.tfevents.*"))

    def forget_earlier(self) -> None:
        """Remove those curves: two trainings would be drawn as one line."""
        for path in self.earlier:
            path.unlink(missing_ok=True)
        self.earlier = []

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        super().log_metrics({shown_as(key): each for key, each in metrics.items() if key not in CONSTANT}, step)

    def log_results(self, results: Mapping[str, float], step: int) -> None:
        """What the test measured. With it, the run has its line in the table of hyperparameters.

        Args:
            results: Each measure's mean.
            step: Of the training.
        """
        self.log_metrics({f"test/{name}": value for name, value in results.items() if name not in COMPARED}, step)
        compared = {shown_as(f"test/{name}"): results[name] for name in COMPARED if name in results}
        known = {
            key: value
            for key, value in dict(self.hparams).items()
            if value not in (None, "") and not key.endswith("_target_")
        }
        super().log_hyperparams(known, compared, step)


def shown_as(name: str) -> str:
    """The name of a value's card: `val/mse` -> `mse/val`, `val/mse_` and a cell -> `per_cell/mse_` and the cell."""
    if name.startswith(OF_CELL):
        return f"per_cell/{name.removeprefix('val/')}"
    return RENAMED.get(name, f"train/{name}" if name.startswith("lr-") else name)
