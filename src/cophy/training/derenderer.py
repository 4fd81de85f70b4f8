"""Stage 1: train and test a de-renderer on single frames (paper, appendix)."""

from collections.abc import Callable

import lightning as L
import numpy as np
import torch
from jaxtyping import Float, UInt8
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from cophy.dataset.frames import FrameBatch, FrameDataModule
from cophy.errors import CophyError
from cophy.models.derenderer import Derendered, Derenderer
from cophy.training.metrics import NOT_FINITE, PerExperiment, gather_devices, over_objects
from cophy.training.optimisation import make_optimizer
from cophy.training.run import Results
from cophy.training.settings import Training


class DerenderingModule(L.LightningModule):
    """A de-renderer under the paper's loss, with presence.

    Attributes:
        tested: After a test, (frame,) values of each metric.
    """

    tested: dict[str, np.ndarray]

    def __init__(self, network: Derenderer, training: Training) -> None:
        super().__init__()
        self.network, self.training_settings = network, training

    def setup(self, stage: str) -> None:
        """Let the network predict positions in units of their spread over the training frames."""
        data = getattr(self.trainer, "datamodule", None)
        if isinstance(data, FrameDataModule) and stage == "fit":
            self.network.scale_(*data.train.position_statistics())

    def make_figures(self, every_n_epochs: int) -> L.Callback:
        """Return the callback that draws validation examples."""
        from cophy.drawing.tensorboard import (
            DerenderingFigures,
        )  # no weight depends on figures, see cophy.training.reuse

        return DerenderingFigures(every_n_epochs)

    def results(self, data: FrameDataModule) -> Results:
        """Return all metrics of the test, which may have ended early (trainer.limit_test_batches)."""
        return Results(self.tested, data.test.clusters[: len(self.tested["mse"])])

    def forward(self, image: UInt8[Tensor, "batch 3 height width"]) -> Derendered:
        """Return positions and presence of the objects in an image."""
        return self.network(image.to(self.network.mean.dtype) / 255)

    def training_step(self, batch: FrameBatch) -> Tensor:
        return self._step("train", batch)

    def validation_step(self, batch: FrameBatch) -> STEP_OUTPUT:
        loss = self._step("val", batch)
        if not torch.isfinite(loss):
            raise CophyError(f"{type(self.network).__name__} {NOT_FINITE}")
        return loss

    def on_test_epoch_start(self) -> None:
        self._test_steps: list[dict[str, Tensor]] = []

    def test_step(self, batch: FrameBatch) -> None:
        output = self(batch.image)
        average = output._replace(position=self.network.mean.expand_as(output.position))
        values = {name: metric(output, batch) for name, metric in DERENDERING_METRICS.items()}
        values["mean_position_error"] = euclidean_error(average, batch)
        self._test_steps.append({name: value.cpu() for name, value in values.items()})

    def on_test_epoch_end(self) -> None:
        steps = gather_devices(self._test_steps)
        self.tested = {name: torch.cat([step[name] for step in steps]).double().numpy() for name in steps[0]}

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return make_optimizer(self, self.training_settings)

    def _step(self, split: str, batch: FrameBatch) -> Float[Tensor, ""]:
        output = self(batch.image)
        values = {name: metric(output, batch).mean() for name, metric in DERENDERING_METRICS.items()}
        logit = output.presence_logit
        loss = values["mse"] + binary_cross_entropy_with_logits(logit, batch.presence.to(logit.dtype))
        logged = {f"{split}/{name}": value for name, value in (values | {"loss": loss}).items()}
        self.log_dict(logged, on_step=False, on_epoch=True, batch_size=len(batch.image), sync_dist=True)
        return loss


def squared_error(output: Derendered, truth: FrameBatch) -> PerExperiment:
    """Return the MSE in m² over the coordinates of present objects, per frame."""
    return over_objects((output.position - truth.position).square().mean(dim=-1), truth.presence)


def euclidean_error(output: Derendered, truth: FrameBatch) -> PerExperiment:
    """Return the distance in m from the true position, mean over present objects, per frame."""
    return over_objects((output.position - truth.position).norm(dim=-1), truth.presence)


def presence_accuracy(output: Derendered, truth: FrameBatch) -> PerExperiment:
    """Return the share of slots whose presence is predicted correctly, per frame."""
    return ((output.presence_logit > 0) == truth.presence).float().mean(dim=1)


def coordinate_error(axis: int) -> Callable[[Derendered, FrameBatch], PerExperiment]:
    """Return the metric of the distance in m along one axis, mean over present objects, per frame."""

    def measure(output: Derendered, truth: FrameBatch) -> PerExperiment:
        return over_objects((output.position - truth.position)[..., axis].abs(), truth.presence)

    return measure


DERENDERING_METRICS: dict[str, Callable[[Derendered, FrameBatch], PerExperiment]] = {
    "mse": squared_error,
    "euclidean_error": euclidean_error,
    "presence_accuracy": presence_accuracy,
    **{f"{name}_error": coordinate_error(axis) for axis, name in enumerate("xyz")},
}
