"""Stage 1: train and test a de-renderer on single frames (paper, appendix)."""

from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits
from torchmetrics import MetricCollection

from cophy.dataset.frames import FrameBatch, FrameDataModule
from cophy.models.derenderer import Derendered, Derenderer
from cophy.training.metrics import collection, over_objects
from cophy.training.optimisation import adam_with_cosine
from cophy.training.settings import Training


class DerenderingModule(L.LightningModule):
    """A de-renderer under the paper's loss, with presence.

    config: the run's resolved configuration as plain values; it travels in every checkpoint. After a test, `tested`
    holds every measure per frame.
    """

    tested: dict[str, np.ndarray]

    def __init__(self, network: Derenderer, training: Training, *, config: dict[str, Any]) -> None:
        super().__init__()
        self.network, self.training_settings, self.config = network, training, config
        self.metrics = nn.ModuleDict({f"in_{split}": collection(MEASURES, f"{split}/") for split in ("train", "val")})

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return True

    def forward(self, image: Tensor) -> Derendered:
        """(B, 3, R, R) uint8 -> positions and presence."""
        return self.network(image.float() / 255)

    def on_fit_start(self) -> None:
        """Positions are learned in units of their spread over the training frames."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        assert isinstance(data, FrameDataModule)
        self.network.scale_(*data.train.position_statistics())

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
        self._test_steps.append(values | {"mean_position_error": euclidean_error(average, batch)})

    def on_test_epoch_end(self) -> None:
        self.tested = {
            name: torch.cat([step[name] for step in self._test_steps]).double().cpu().numpy()
            for name in self._test_steps[0]
        }

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return adam_with_cosine(self, self.training_settings.learning_rate)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["config"] = self.config

    def _step(self, split: str, batch: FrameBatch) -> Tensor:
        found = self(batch.image)
        metrics = self.metrics[f"in_{split}"]
        assert isinstance(metrics, MetricCollection)
        metrics(found, batch)
        self.log_dict(metrics, on_step=False, on_epoch=True)
        position = squared_error(found, batch).mean()
        presence = binary_cross_entropy_with_logits(found.presence_logit, batch.presence.float())
        self.log(f"{split}/loss", position + presence, on_step=False, on_epoch=True, batch_size=len(batch.image))
        return position + presence


def squared_error(found: Derendered, batch: FrameBatch) -> Tensor:
    """(B,) MSE in m² over the coordinates of present objects."""
    return over_objects((found.position - batch.position).square().mean(dim=-1), batch.presence)


def euclidean_error(found: Derendered, batch: FrameBatch) -> Tensor:
    """(B,) distance in m from the true position, mean over present objects."""
    return over_objects((found.position - batch.position).norm(dim=-1), batch.presence)


def presence_accuracy(found: Derendered, batch: FrameBatch) -> Tensor:
    """(B,) share of slots of which is said rightly whether they hold an object."""
    return ((found.presence_logit > 0) == batch.presence).float().mean(dim=1)


def _coordinate_error(axis: int) -> Any:
    def value(found: Derendered, batch: FrameBatch) -> Tensor:
        return over_objects((found.position - batch.position)[..., axis].abs(), batch.presence)

    return value


MEASURES = {
    "mse": squared_error,
    "euclidean_error": euclidean_error,
    "presence_accuracy": presence_accuracy,
    **{f"{name}_error": _coordinate_error(axis) for axis, name in enumerate("xyz")},
}
