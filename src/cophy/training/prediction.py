"""Stage 2: train and test a predictor of D."""

import math
from typing import Any

import lightning as L
import torch
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR
from torchmetrics import MetricCollection

from cophy.training.losses import position_loss, stability_loss
from cophy.training.metrics import position_metrics, stability_metrics
from cophy.training.settings import Training
from cophy.types import Batch, Prediction


class PredictionModule(L.LightningModule):
    """Any network from `Batch` to `Prediction`, under the paper's losses and metrics.

    config: the run's resolved configuration as plain values; it travels in every checkpoint.
    """

    def __init__(self, network: nn.Module, training: Training, *, metric_dims: int, config: dict[str, Any]) -> None:
        super().__init__()
        self.network, self.training_settings, self.config = network, training, config
        splits = ("train", "val", "test")
        self.position_metrics = nn.ModuleDict({f"in_{s}": position_metrics(metric_dims).clone(f"{s}/") for s in splits})
        self.stability_metrics = nn.ModuleDict({f"in_{s}": stability_metrics().clone(f"{s}/") for s in splits})

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return any(parameter.requires_grad for parameter in self.network.parameters())

    def forward(self, batch: Batch) -> Prediction:
        return self.network(batch)

    def training_step(self, batch: Batch) -> Tensor:
        prediction = self(batch)
        self._measure("train", prediction, batch)
        return self._loss("train", prediction, batch)

    def validation_step(self, batch: Batch) -> STEP_OUTPUT:
        prediction = self(batch)
        self._measure("val", prediction, batch)
        return self._loss("val", prediction, batch)

    def test_step(self, batch: Batch) -> None:
        self._measure("test", self(batch), batch)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam, its learning rate falling to zero along a cosine over the epochs of the run (also of a longer resumed one)."""
        optimizer = torch.optim.Adam(self.network.parameters(), lr=self.training_settings.learning_rate)
        epochs = max(self.trainer.max_epochs or 1, 1)
        schedule = LambdaLR(optimizer, lambda epoch: (1 + math.cos(math.pi * min(epoch / epochs, 1))) / 2)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["config"] = self.config

    def _loss(self, split: str, prediction: Prediction, batch: Batch) -> Tensor:
        losses = {"position_loss": position_loss(prediction, batch)}
        loss = self.training_settings.position_weight * losses["position_loss"]
        if prediction.stable_logit is not None:
            losses["stability_loss"] = stability_loss(prediction.stable_logit, batch)
            loss = loss + self.training_settings.stability_weight * losses["stability_loss"]
        values = {f"{split}/{name}": value for name, value in {"loss": loss, **losses}.items()}
        self.log_dict(values, on_step=False, on_epoch=True, batch_size=len(batch.initial))
        return loss

    def _measure(self, split: str, prediction: Prediction, batch: Batch) -> None:
        groups = [self.position_metrics]
        if prediction.stable_logit is not None:
            groups.append(self.stability_metrics)
        for group in groups:
            metrics = group[f"in_{split}"]
            assert isinstance(metrics, MetricCollection)
            with torch.no_grad():
                metrics.update(prediction, batch)
            for name, metric in metrics.items(keep_base=False):
                self.log(name, metric, on_step=False, on_epoch=True, prog_bar=name == "val/mse")
