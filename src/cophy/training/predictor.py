"""Stage 2: train and test a predictor of D.

What a network has to return. A model of one's own is easily wrong here, and tensors that broadcast hide it.
"""

import math
from dataclasses import replace

import lightning as L
import numpy as np
import torch
from jaxtyping import Float
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn
from torchmetrics import MetricCollection

from cophy.dataset.datamodules import Share
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.augmentation import augment, disturb
from cophy.training.losses import confounder_loss, position_loss, stability_loss
from cophy.training.metrics import (
    MeanOfEachCell,
    StandingConfusion,
    collection,
    have_twins,
    mean_squared_error,
    of_all_devices,
    position_measures,
    stability_measures,
    twin_collection,
)
from cophy.training.settings import Training, optimisation
from cophy.types import Batch, Prediction, Targets, map_tensors

NOT_FINITE = "predicts what is not finite: lower training.learning_rate, or look for a division by zero in the model"


def estimate_dim(network: nn.Module) -> int:
    """Width of the estimate U that a network says it makes; 0 if it makes none."""
    return int(getattr(network, "estimate_dim", 0))


def check_shapes(prediction: Prediction, targets: Targets, network: nn.Module) -> None:
    """Compare what a network returned with what the targets ask for.

    Args:
        prediction: What it returned.
        targets: What it is judged by.
        network: Named in the error; its `estimate_dim`, if it has one, is the width of U.

    Raises:
        CophyError: A part is missing, or has another type or shape.
    """
    name, width = type(network).__name__, estimate_dim(network)
    if not isinstance(prediction, Prediction):
        raise CophyError(f"{name} returns {type(prediction).__name__}, not cophy.types.Prediction")
    size, steps, slots, _ = targets.position.shape
    estimate = prediction.confounder_estimate
    if estimate is None and width:
        raise CophyError(f"{name} has an estimate_dim, but returns no confounder_estimate")
    expected: list[tuple[str, Tensor | None, tuple[tuple[int, ...], ...]]] = [
        ("position", prediction.position, ((size, steps, slots, 3),)),
        ("stable_logit", prediction.stable_logit, ((size, steps, slots), (size, 1, slots))),
        ("confounder_estimate", estimate, ((size, slots, width or (0 if estimate is None else estimate.shape[-1])),)),
    ]
    for field, tensor, shapes in expected:
        if tensor is not None and (tuple(tensor.shape) not in shapes or not tensor.is_floating_point()):
            choices = " or ".join(map(str, shapes))
            raise CophyError(
                f"{name} returns {field} {tensor.dtype} of shape {tuple(tensor.shape)}, not floats of {choices} (cophy/types.py)"
            )


class PredictionModule(L.LightningModule):
    """Any network from `Inputs` to `Prediction`, under the paper's losses and metrics.

    Attributes:
        tested: After a test, on the CPU: the predictions and what they were made for.
        standing: After a validation of towers: `StandingConfusion`; None where nothing is said about stability.
    """

    tested: tuple[Prediction, Batch]
    standing: np.ndarray | None = None
    augmentations: Float[Tensor, "augmentation 2 2"]
    missed_position: Float[Tensor, "3"]

    def __init__(
        self,
        network: nn.Module,
        training: Training,
        scenario: Scenario,
        *,
        augmentations: np.ndarray,
        missed_position: Float[Tensor, "3"],
        seed: int = 0,
    ) -> None:
        """Wrap a network.

        Args:
            network: From `Inputs` to `Prediction`.
            training: Weights of the losses, and the learning rate.
            scenario: How predictions are judged, and the values of confounders.
            augmentations: (augmentation, 2, 2) matrices, by which training experiments are turned at random.
            missed_position: Where an object is predicted that the de-renderer missed in C, metres.
            seed: Of the training: how experiments are turned, and noise, follow from it, the epoch and the step.
        """
        super().__init__()
        self.network, self.training_settings, self.seed = network, training, seed
        self.register_buffer("missed_position", missed_position, persistent=False)
        self.register_buffer("augmentations", torch.from_numpy(augmentations).float(), persistent=False)
        self.confounder_heads = _confounder_heads(network, scenario) if training.confounder_weight else None
        measures = {"position": position_measures(scenario.task), "stability": stability_measures()}
        self.metrics = nn.ModuleDict(
            {f"in_{s}_{kind}": collection(m, f"{s}/") for s in ("train", "val") for kind, m in measures.items()}
        )
        self.metrics["in_val_twins"] = twin_collection(scenario.task.metric_dims, "val/")  # in training, twins part
        self.cells, self.squared_error = scenario.cells(), mean_squared_error(scenario.task.metric_dims)
        self.mse_of_cells = MeanOfEachCell(len(self.cells))
        self.confusion = StandingConfusion() if scenario.statics is not None else None

    def forward(self, batch: Batch) -> Prediction:
        """Predict D; only `batch.inputs` reaches the network."""
        prediction = self.network(batch.inputs)
        check_shapes(prediction, batch.targets, self.network)
        return place_missed(prediction, batch, self.missed_position)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        draw, share = (self.seed, self.current_epoch, batch_idx), Share.of(self.trainer)
        noise = self.training_settings.position_noise
        with torch.autocast(self.device.type, enabled=False):  # positions keep their precision in mixed training
            batch = augment(batch, self.augmentations, draw, share)
            batch = disturb(batch, noise, draw, share) if noise else batch
        prediction = self(batch)
        self._measure("train", prediction, batch)
        return self._loss("train", prediction, batch)

    def on_validation_epoch_start(self) -> None:
        self.mse_of_cells.reset()
        self.standing = None
        if self.confusion is not None:
            self.confusion.reset()

    def validation_step(self, batch: Batch) -> STEP_OUTPUT:
        prediction = self(batch)
        loss = self._loss("val", prediction, batch)
        if not torch.isfinite(loss):
            raise CophyError(f"{type(self.network).__name__} {NOT_FINITE}")
        self._measure("val", prediction, batch)
        self.mse_of_cells.update(self.squared_error(prediction, batch.targets), batch.targets.cell)
        if self.confusion is not None and prediction.stable_logit is not None:
            self.confusion.update(prediction, batch.targets)
        return loss

    def on_validation_epoch_end(self) -> None:
        if len(self.cells) > 1:
            found = zip(self.cells, self.mse_of_cells.compute().tolist(), strict=True)
            self.log_dict({f"val/mse_{cell}": mse for cell, mse in found if not math.isnan(mse)}, sync_dist=True)
        if self.confusion is not None and self.confusion.update_called:
            self.standing = self.confusion.compute().cpu().numpy()

    def on_test_epoch_start(self) -> None:
        self._test_steps: list[tuple[Prediction, Batch]] = []

    def test_step(self, batch: Batch) -> None:
        self._test_steps.append((map_tensors(_kept, self(batch)), map_tensors(_kept, batch)))

    def on_test_epoch_end(self) -> None:
        predictions, batches = zip(*of_all_devices(self._test_steps), strict=True)
        self.tested = (
            map_tensors(lambda *parts: torch.cat(parts), *predictions),
            map_tensors(lambda *parts: torch.cat(parts), *batches),
        )

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return optimisation(self, self.training_settings)

    def _loss(self, split: str, prediction: Prediction, batch: Batch) -> Float[Tensor, ""]:
        """The weighted sum of the terms (paper Sec. 4.2, Training); each is logged."""
        settings, targets = self.training_settings, batch.targets
        terms = {"position_loss": (settings.position_weight, position_loss(prediction, targets))}
        if prediction.stable_logit is not None:
            terms["stability_loss"] = settings.stability_weight, stability_loss(prediction.stable_logit, targets)
        if self.confounder_heads is not None:
            logits = [head(prediction.confounder_estimate) for head in self.confounder_heads]
            terms["confounder_loss"] = settings.confounder_weight, confounder_loss(logits, targets)
        loss = torch.stack([weight * value for weight, value in terms.values()]).sum()
        values = {f"{split}/{name}": value for name, (_, value) in terms.items()}
        for named, in_bar in ((values, False), ({f"{split}/loss": loss}, split == "train")):
            self.log_dict(named, on_step=False, on_epoch=True, batch_size=len(batch), sync_dist=True, prog_bar=in_bar)
        return loss

    def _measure(self, split: str, prediction: Prediction, batch: Batch) -> None:
        kinds = ["position"] if prediction.stable_logit is None else ["position", "stability"]
        if split == "val" and have_twins(batch.targets.pair):
            kinds.append("twins")
        for kind in kinds:
            metrics = self.metrics[f"in_{split}_{kind}"]
            assert isinstance(metrics, MetricCollection)
            with torch.no_grad():
                metrics.update(prediction, batch.targets)
            for name, metric in metrics.items(keep_base=False):
                self.log(name, metric, on_step=False, on_epoch=True, prog_bar=name == "val/mse")


def place_missed(prediction: Prediction, batch: Batch, position: Float[Tensor, "3"]) -> Prediction:
    """The prediction, with the objects that the de-renderer missed in C at one position.

    Args:
        prediction: Of D.
        batch: What it was made for.
        position: Metres.
    """
    missed = (batch.targets.presence & ~batch.inputs.presence)[:, None, :, None]
    return replace(prediction, position=torch.where(missed, position, prediction.position))


def _kept(tensor: Tensor) -> Tensor:
    """On the CPU, and at least in single precision: NumPy knows no bfloat16."""
    reduced = tensor.dtype in (torch.bfloat16, torch.float16)
    return tensor.float().cpu() if reduced else tensor.cpu()


def _confounder_heads(network: nn.Module, scenario: Scenario) -> nn.ModuleList:
    """A linear classifier of mass and one of friction on every object's U (paper, appendix)."""
    width = estimate_dim(network)
    if not width:
        raise CophyError(
            "training.confounder_weight (ablation=supervised_confounders) needs a model that estimates confounders from AB, "
            "with an attribute estimate_dim"
        )
    grid = scenario.confounders
    return nn.ModuleList(nn.Linear(width, len(values)) for values in (grid.mass, grid.friction))
