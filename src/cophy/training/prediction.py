"""Stage 2: train and test a predictor of D."""

from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn
from torchmetrics import MetricCollection

from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.augmentation import augment
from cophy.training.evaluation import NOT_FINITE
from cophy.training.losses import confounder_loss, position_loss, stability_loss
from cophy.training.metrics import collection, position_measures, stability_measures
from cophy.training.optimisation import adam_with_cosine
from cophy.training.settings import Training
from cophy.types import Batch, Prediction, map_fields, without_truth


class PredictionModule(L.LightningModule):
    """Any network from `Batch` to `Prediction`, under the paper's losses and metrics.

    symmetries: what training experiments are turned by at random, see `augmentation`. config: the run's resolved configuration as plain values; it travels in every checkpoint. After a test, `tested`
    holds the predictions and what they were made for, on the CPU.
    """

    tested: tuple[Prediction, Batch]
    symmetries: Tensor
    missed_position: Tensor

    def __init__(
        self,
        network: nn.Module,
        training: Training,
        scenario: Scenario,
        symmetries: np.ndarray,
        *,
        config: dict[str, Any],
    ) -> None:
        super().__init__()
        self.network, self.training_settings, self.config = network, training, config
        self.register_buffer("missed_position", torch.zeros(3), persistent=False)
        self.register_buffer("symmetries", torch.from_numpy(symmetries).float(), persistent=False)
        self.confounder_heads = _confounder_heads(network, scenario) if training.confounder_weight else None
        measures = {"position": position_measures(scenario.task), "stability": stability_measures()}
        self.metrics = nn.ModuleDict(
            {f"in_{s}_{kind}": collection(m, f"{s}/") for s in ("train", "val") for kind, m in measures.items()}
        )

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return any(parameter.requires_grad for parameter in self.network.parameters())

    def forward(self, batch: Batch) -> Prediction:
        prediction = self.network(without_truth(batch))
        _check_shapes(prediction, batch, self.network)
        missed = (batch.target_presence & ~batch.presence)[:, None, :, None]
        return prediction._replace(position=torch.where(missed, self.missed_position, prediction.position))

    def setup(self, stage: str) -> None:
        """An object that the de-renderer missed in C is predicted where objects are on average."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        assert isinstance(data, CounterfactualDataModule)
        self.missed_position.copy_(data.mean_position)

    def training_step(self, batch: Batch) -> Tensor:
        batch = augment(batch, self.symmetries)
        prediction = self(batch)
        self._measure("train", prediction, batch)
        return self._loss("train", prediction, batch)

    def validation_step(self, batch: Batch) -> STEP_OUTPUT:
        prediction = self(batch)
        loss = self._loss("val", prediction, batch)
        if not torch.isfinite(loss):
            raise CophyError(f"{type(self.network).__name__} {NOT_FINITE}")
        self._measure("val", prediction, batch)
        return loss

    def on_test_epoch_start(self) -> None:
        self._test_steps: list[tuple[Prediction, Batch]] = []

    def test_step(self, batch: Batch) -> None:
        self._test_steps.append((map_fields(torch.Tensor.cpu, self(batch)), map_fields(torch.Tensor.cpu, batch)))

    def on_test_epoch_end(self) -> None:
        predictions, batches = zip(*self._test_steps, strict=True)
        self.tested = (
            map_fields(lambda *parts: torch.cat(parts), *predictions),
            map_fields(lambda *parts: torch.cat(parts), *batches),
        )

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return adam_with_cosine(self, self.training_settings.learning_rate)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["config"] = self.config

    def _loss(self, split: str, prediction: Prediction, batch: Batch) -> Tensor:
        settings, terms = self.training_settings, {}
        terms["position_loss"] = settings.position_weight, position_loss(prediction, batch)
        if prediction.stable_logit is not None:
            terms["stability_loss"] = settings.stability_weight, stability_loss(prediction.stable_logit, batch)
        if self.confounder_heads is not None:
            logits = [head(prediction.confounder_estimate) for head in self.confounder_heads]
            terms["confounder_loss"] = settings.confounder_weight, confounder_loss(logits, batch)
        loss = torch.stack([weight * value for weight, value in terms.values()]).sum()
        values = {f"{split}/{name}": value for name, (_, value) in terms.items()} | {f"{split}/loss": loss}
        self.log_dict(values, on_step=False, on_epoch=True, batch_size=len(batch.initial))
        return loss

    def _measure(self, split: str, prediction: Prediction, batch: Batch) -> None:
        kinds = ["position"] if prediction.stable_logit is None else ["position", "stability"]
        for kind in kinds:
            metrics = self.metrics[f"in_{split}_{kind}"]
            assert isinstance(metrics, MetricCollection)
            with torch.no_grad():
                metrics.update(prediction, batch)
            for name, metric in metrics.items(keep_base=False):
                self.log(name, metric, on_step=False, on_epoch=True, prog_bar=name == "val/mse")


def _confounder_heads(network: nn.Module, scenario: Scenario) -> nn.ModuleList:
    """A linear classifier of mass and one of friction on every object's U (paper, appendix)."""
    width = getattr(network, "estimate_dim", None)
    if not width:
        raise CophyError(
            "training.confounder_weight (ablation=supervised_confounders) needs a model that estimates confounders from AB, "
            "with an attribute estimate_dim"
        )
    grid = scenario.confounders
    return nn.ModuleList(nn.Linear(width, len(values)) for values in (grid.mass, grid.friction))


def _check_shapes(prediction: Prediction, batch: Batch, network: nn.Module) -> None:
    """A model of one's own is easily wrong here, and tensors that broadcast would be wrong silently."""
    name = type(network).__name__
    if not isinstance(prediction, Prediction):
        raise CophyError(f"{name} returns {type(prediction).__name__}, not cophy.types.Prediction")
    size, steps, slots, _ = batch.target.shape
    expected: list[tuple[str, Tensor | None, tuple[tuple[int, ...], ...]]] = [
        ("position", prediction.position, ((size, steps, slots, 3),)),
        ("stable_logit", prediction.stable_logit, ((size, steps, slots), (size, 1, slots))),
    ]
    if prediction.confounder_estimate is None and getattr(network, "estimate_dim", None):
        raise CophyError(f"{name} has an estimate_dim, but returns no confounder_estimate")
    if prediction.confounder_estimate is not None:
        width = getattr(network, "estimate_dim", prediction.confounder_estimate.shape[-1])
        expected.append(("confounder_estimate", prediction.confounder_estimate, ((size, slots, width),)))
    for field, tensor, shapes in expected:
        if tensor is not None and (tuple(tensor.shape) not in shapes or not tensor.is_floating_point()):
            choices = " or ".join(map(str, shapes))
            raise CophyError(
                f"{name} returns {field} {tensor.dtype} of shape {tuple(tensor.shape)}, not floats of {choices} (cophy/types.py)"
            )
