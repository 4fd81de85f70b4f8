"""Stage 1: train and test a de-renderer on single frames (paper, appendix)."""

from collections.abc import Callable

import lightning as L
import numpy as np
import torch
from jaxtyping import Float, UInt8
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits
from torchmetrics import MetricCollection

from cophy.dataset.frames import FrameBatch
from cophy.models.derenderer import Derendered, Derenderer
from cophy.training.metrics import PerExperiment, collection, of_all_devices, over_objects
from cophy.training.settings import Training, optimisation


class DerenderingModule(L.LightningModule):
    """A de-renderer under the paper's loss, with presence.

    Attributes:
        tested: After a test, every measure per frame.
    """

    tested: dict[str, np.ndarray]

    def __init__(self, network: Derenderer, training: Training) -> None:
        super().__init__()
        self.network, self.training_settings = network, training
        self.metrics = nn.ModuleDict({f"in_{split}": collection(MEASURES, f"{split}/") for split in ("train", "val")})

    def forward(self, image: UInt8[Tensor, "batch 3 height width"]) -> Derendered:
        """Positions and presence of what a picture shows."""
        return self.network(image.to(self.network.mean.dtype) / 255)

    def training_step(self, batch: FrameBatch) -> Tensor:
        return self._step("train", batch)

    def validation_step(self, batch: FrameBatch) -> STEP_OUTPUT:
        return self._step("val", batch)

    def on_test_epoch_start(self) -> None:
        self._test_steps: list[dict[str, Tensor]] = []

    def test_step(self, batch: FrameBatch) -> None:
        found = self(batch.image)
        average = found._replace(position=self.network.mean.expand_as(found.position))
        values = {name: measure(found, batch) for name, measure in MEASURES.items()}
        values["mean_position_error"] = euclidean_error(average, batch)
        self._test_steps.append({name: value.cpu() for name, value in values.items()})

    def on_test_epoch_end(self) -> None:
        steps = of_all_devices(self._test_steps)
        self.tested = {name: torch.cat([step[name] for step in steps]).double().numpy() for name in steps[0]}

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return optimisation(self, self.training_settings)

    def _step(self, split: str, batch: FrameBatch) -> Float[Tensor, ""]:
        found = self(batch.image)
        metrics = self.metrics[f"in_{split}"]
        assert isinstance(metrics, MetricCollection)
        metrics(found, batch)
        self.log_dict(metrics, on_step=False, on_epoch=True)
        position = squared_error(found, batch).mean()
        logit = found.presence_logit
        presence = binary_cross_entropy_with_logits(logit, batch.presence.to(logit.dtype))
        self.log(
            f"{split}/loss",
            position + presence,
            on_step=False,
            on_epoch=True,
            batch_size=len(batch.image),
            sync_dist=True,
        )
        return position + presence


def squared_error(found: Derendered, truth: FrameBatch) -> PerExperiment:
    """MSE in m² over the coordinates of present objects, of each frame."""
    return over_objects((found.position - truth.position).square().mean(dim=-1), truth.presence)


def euclidean_error(found: Derendered, truth: FrameBatch) -> PerExperiment:
    """Distance in m from the true position, mean over present objects, of each frame."""
    return over_objects((found.position - truth.position).norm(dim=-1), truth.presence)


def presence_accuracy(found: Derendered, truth: FrameBatch) -> PerExperiment:
    """Share of slots of which is said rightly whether they hold an object, of each frame."""
    return ((found.presence_logit > 0) == truth.presence).float().mean(dim=1)


def coordinate_error(axis: int) -> Callable[[Derendered, FrameBatch], PerExperiment]:
    """Distance in m along one axis, mean over present objects, of each frame."""

    def measure(found: Derendered, truth: FrameBatch) -> PerExperiment:
        return over_objects((found.position - truth.position)[..., axis].abs(), truth.presence)

    return measure


MEASURES: dict[str, Callable[[Derendered, FrameBatch], PerExperiment]] = {
    "mse": squared_error,
    "euclidean_error": euclidean_error,
    "presence_accuracy": presence_accuracy,
    **{f"{name}_error": coordinate_error(axis) for axis, name in enumerate("xyz")},
}
