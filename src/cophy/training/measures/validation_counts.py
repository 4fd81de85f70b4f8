"""What validation counts beside its means: the MSE of each cell, and towers that stand or fall."""

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.classification import BinaryConfusionMatrix

from cophy.training.measures.metrics import PerExperiment
from cophy.types import Prediction, Targets


class MeanOfEachCell(Metric):
    """Mean over the experiments of each cell; NaN where there are none. Experiments of unknown cell (-1) do not count."""

    total: Tensor
    count: Tensor

    def __init__(self, num_cells: int) -> None:
        super().__init__()
        for name, dtype in (("total", torch.float64), ("count", torch.int64)):
            self.add_state(name, torch.zeros(num_cells, dtype=dtype), dist_reduce_fx="sum")

    def update(self, values: PerExperiment, cell: Tensor) -> None:
        """Add a batch: a value and the index of a cell per experiment."""
        known = cell >= 0
        self.total.index_add_(0, cell[known], values[known].to(self.total))  # trainer.precision may have changed it
        self.count.index_add_(0, cell[known], torch.ones_like(cell[known]))

    def compute(self) -> Tensor:
        """(num_cells,) over all batches."""
        return self.total / self.count


class StandingConfusion(BinaryConfusionMatrix):
    """(2, 2) experiments: rows whether the tower of CD truly stands, columns whether it is said to.

    It stands if every object is stable at every step.
    """

    def update(self, prediction: Prediction, targets: Targets) -> None:  # type: ignore[override]
        """Add a batch of a model that says whether objects are stable."""
        assert prediction.stable_logit is not None
        empty = ~targets.presence[:, None]
        said, true = (
            (stable | empty).flatten(1).all(dim=1) for stable in (prediction.stable_logit > 0, targets.stable)
        )
        super().update(said.long(), true.long())
