"""Stage 2: train and test a predictor of D (paper Sec. 4)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import lightning as L
import numpy as np
import torch
from jaxtyping import Float
from lightning.pytorch.utilities.types import STEP_OUTPUT, OptimizerLRScheduler
from torch import Tensor, nn

from cophy.dataset.datamodules import CounterfactualDataModule, DeviceShare
from cophy.errors import CophyError
from cophy.models.baselines import CopyB, CopyC
from cophy.models.trees import Trees
from cophy.scenario import Camera, Scenario
from cophy.scoring import Predictions, Scores, Truth, mse_of_copies, score
from cophy.training.augmentation import add_position_noise, augment, matrices_of
from cophy.training.instantiation import instantiate_function
from cophy.training.losses import MSE, confounder_loss, position_loss, stability_loss
from cophy.training.metrics import (
    NOT_FINITE,
    gather_devices,
    mean_squared_error,
    own_measures,
    place_missed,
    standing_confusion,
)
from cophy.training.optimisation import make_optimizer
from cophy.training.probe import Probed, collect_estimates, probe, probe_accuracies, warn_if_constant
from cophy.training.run import Results
from cophy.training.settings import Training
from cophy.types import Batch, Inputs, Prediction, Targets, map_tensors, move_to, take

NUM_PREDICTED_ALONE = 8  # experiments that are predicted one at a time, to compare with those of a batch
ALLOWED_DIFFERENCE_M = 1e-3  # between both; rounding makes less
ALLOWED_RELATIVE_DIFFERENCE = 1e-3  # of the largest movement of the experiment, for networks that predict large ones


def estimate_dim(network: nn.Module) -> int:
    """Return the width of a network's estimate U; 0 if it has none."""
    return int(getattr(network, "estimate_dim", 0))


def check_shapes(prediction: object, targets: Targets, network: nn.Module) -> None:
    """Compare the output of a network with its targets: a user's model may be wrong, and broadcasting would hide it.

    Raises:
        CophyError: A field is missing, or has another type or shape.
    """
    name, width = type(network).__name__, estimate_dim(network)
    if not isinstance(prediction, Prediction):
        raise CophyError(f"{name} returns {type(prediction).__name__}, not cophy.types.Prediction")
    size, steps, slots, _ = targets.position.shape
    estimate = prediction.confounder_estimate
    if estimate is None and width:
        raise CophyError(f"{name} has an estimate_dim, but returns no confounder_estimate")
    if prediction.draw_variance is not None:  # it would be subtracted from squared errors
        raise CophyError(f"{name} returns draw_variance, which is for oracles")
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

    Args:
        network: From `Inputs` to `Prediction`.
        training: Losses, augmentation, optimiser.
        scenario: Says which coordinates count, and the values of confounders.
        seed: Augmentation and noise are functions of it, the epoch and the step.
        metrics: Those of the user, see `own_measures`.

    Attributes:
        tested: After a test, on the CPU: the predictions, their batch, and (experiment,) their rows in the test split.
        standing: After a validation of towers: `standing_confusion`; None if the network does not predict stability.
    """

    tested: tuple[Prediction, Batch, np.ndarray]
    standing: np.ndarray | None = None
    augmentations: Float[Tensor, "augmentation 2 2"]
    missed_position: Float[Tensor, "3"]

    def __init__(
        self,
        network: nn.Module,
        training: Training,
        scenario: Scenario,
        *,
        seed: int = 0,
        metrics: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.network, self.training_settings, self.seed = network, training, seed
        self.position_loss = instantiate_function("training.loss", training.loss or MSE)
        # where objects are predicted that the de-renderer missed in C, metres; see `setup`
        self.register_buffer("missed_position", torch.zeros(3), persistent=False)
        matrices = torch.from_numpy(matrices_of(scenario, training.augmentation)).float()
        self.register_buffer("augmentations", matrices, persistent=False)
        self.confounder_heads = _confounder_heads(network, scenario) if training.confounder_weight else None
        self.cells, self.squared_error = scenario.cells(), mean_squared_error(scenario.task.metric_dims)
        self.own_measures = own_measures(metrics or {}, {f"mse_{cell}" for cell in self.cells})
        self.scenario = scenario
        self._steps: list[tuple[Prediction, Batch]] = []

    def setup(self, stage: str) -> None:
        """Take from the training data where missed objects are predicted, and fit trees."""
        data = getattr(self.trainer, "datamodule", None)
        if isinstance(data, CounterfactualDataModule):
            self.missed_position.copy_(data.mean_position)
            if isinstance(self.network, Trees) and self.network.regressor is None:
                self.network.fit(data.train.batch, self.scenario, data.confounder_statistics, self.seed)

    def make_figures(self, every_n_epochs: int) -> L.Callback:
        """Return the callback that draws validation examples."""
        from cophy.drawing.tensorboard import (
            PredictionFigures,
        )  # no weight depends on figures, see cophy.training.reuse

        return PredictionFigures(self.scenario, every_n_epochs)

    def results(self, data: CounterfactualDataModule) -> Results:
        """Return all metrics of the test and the predictions, with twins next to each other."""
        self.check_batches(data.test.batch.inputs)
        prediction, batch, rows = self.tested
        pair = data.test_set.pairs(data.test_experiments[rows])
        order = np.argsort(pair, kind="stable")
        prediction, batch = take(prediction, torch.from_numpy(order)), take(batch, torch.from_numpy(order))
        experiments, pair = data.test_experiments[rows][order], pair[order].astype(np.int64)
        clusters = data.test_set.clusters(experiments)
        targets = batch.targets = replace(batch.targets, pair=torch.from_numpy(pair))
        arrays = prediction_arrays(prediction, targets, experiments, clusters)
        truth, scores = self._score(arrays, self.scenario.camera)
        own = {name: measure(prediction, targets).numpy() for name, measure in self.own_measures.items()}
        values = {**scores.values, **own}
        if prediction.confounder_estimate is not None:
            tested = Probed(prediction.confounder_estimate, targets)
            warn_if_constant(tested)
            if data.knows_confounders and not data.estimated:
                train = data.train.batch
                estimate = collect_estimates(self.network, train.inputs, batch_size=self.training_settings.batch_size)
                probed = probe(Probed(estimate, train.targets), tested)
                arrays, values = arrays | probed, {**values, **probe_accuracies(probed)}
        copies = {
            name: place_missed(copy(batch.inputs), batch, data.mean_position).position.numpy()
            for name, copy in {"copy_c": CopyC(), "copy_b": CopyB()}.items()
        }
        return Results(values, scores.cluster, mse_of_copies(copies, truth), arrays)

    def check_batches(self, inputs: Inputs) -> None:
        """Compare predictions of single experiments with those of a batch: each must depend on its own AB and C alone.

        Raises:
            CophyError: They differ by more than rounding.
        """
        network, weights = self.network.eval(), next(self.network.parameters(), torch.zeros(()))
        if torch.finfo(weights.dtype).bits < 32:  # rounding differs with the size of the batch
            return
        inputs = move_to(take(inputs, slice(self.training_settings.batch_size)), weights.device, weights.dtype)
        with torch.no_grad():
            together = network(inputs).position[:NUM_PREDICTED_ALONE]
            rows = range(len(together))
            alone = torch.cat([network(take(inputs, slice(row, row + 1))).position for row in rows])
        present = inputs.presence[: len(together), None]
        difference, movement = (
            torch.where(present, vector.norm(dim=-1), 0.0).amax(dim=(1, 2))
            for vector in (alone - together, together - inputs.initial[: len(together), None])
        )
        if (difference > (ALLOWED_RELATIVE_DIFFERENCE * movement).clamp(min=ALLOWED_DIFFERENCE_M)).any():
            raise CophyError(
                f"{type(network).__name__}: its prediction of an experiment depends on the other experiments of the batch, "
                f"by {float(difference.max()):.3g} m: use no statistics of the batch in evaluation"
            )

    def forward(self, batch: Batch) -> Prediction:
        """Predict D; only `batch.inputs` reaches the network."""
        prediction = self.network(batch.inputs)
        check_shapes(prediction, batch.targets, self.network)
        return place_missed(prediction, batch, self.missed_position)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        draw, share = (self.seed, self.current_epoch, batch_idx), DeviceShare.of(self.trainer)
        noise = self.training_settings.position_noise
        with torch.autocast(self.device.type, enabled=False):  # positions keep their precision in mixed training
            batch = augment(batch, self.augmentations, draw, share)
            batch = add_position_noise(batch, noise, draw, share) if noise else batch
        prediction = self(batch)
        with torch.no_grad():
            mse = self.squared_error(prediction, batch.targets).mean()
        self.log("train/mse", mse, on_step=False, on_epoch=True, batch_size=len(batch), sync_dist=True)
        loss = self._loss("train", prediction, batch)
        if not loss.requires_grad and any(each.requires_grad for each in self.parameters()):
            raise CophyError(
                f"{type(self.network).__name__}: the loss does not depend on its parameters, so nothing can be trained: look "
                "for .detach(), .data, torch.no_grad() or NumPy in the model, and in a loss of your own"
            )
        return loss

    def validation_step(self, batch: Batch) -> STEP_OUTPUT:
        prediction = self(batch)
        loss = self._loss("val", prediction, batch)
        if not torch.isfinite(loss):
            raise CophyError(f"{type(self.network).__name__} {NOT_FINITE}")
        self._keep(prediction, batch)
        return loss

    def on_validation_epoch_end(self) -> None:
        prediction, batch = self._gather()
        targets = batch.targets
        arrays = prediction_arrays(prediction, targets, np.arange(len(targets)), targets.pair.numpy())
        _, scores = self._score(arrays)
        values = scores.means()
        values |= {name: float(measure(prediction, targets).mean()) for name, measure in self.own_measures.items()}
        if len(self.cells) > 1:
            mse, cell = scores.mse, arrays["cell"]
            values |= {f"mse_{name}": mse[cell == i].mean() for i, name in enumerate(self.cells) if i in cell}
        for name, value in values.items():
            self.log(f"val/{name}", value, sync_dist=True, prog_bar=name == "mse")
        if self.scenario.statics is not None and prediction.stable_logit is not None:
            self.standing = standing_confusion(prediction, targets)

    def test_step(self, batch: Batch) -> None:
        self._keep(self(batch), batch)

    def on_test_epoch_end(self) -> None:
        prediction, batch = self._gather()
        self.tested = prediction, batch, np.arange(len(batch))

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return make_optimizer(self, self.training_settings)

    def _loss(self, split: str, prediction: Prediction, batch: Batch) -> Float[Tensor, ""]:
        """Log the terms of the loss and return their weighted sum (paper Sec. 4.2, Training)."""
        settings, targets = self.training_settings, batch.targets
        terms = {"position_loss": (settings.position_weight, position_loss(prediction, targets, self.position_loss))}
        if prediction.stable_logit is not None:
            terms["stability_loss"] = settings.stability_weight, stability_loss(prediction.stable_logit, targets)
        if self.confounder_heads is not None:
            logits = [head(prediction.confounder_estimate) for head in self.confounder_heads]
            terms["confounder_loss"] = settings.confounder_weight, confounder_loss(logits, targets)
        loss = torch.stack([weight * value for weight, value in terms.values()]).sum()
        values = {f"{split}/{name}": value for name, (_, value) in terms.items()}
        for logged, in_bar in ((values, False), ({f"{split}/loss": loss}, split == "train")):
            self.log_dict(logged, on_step=False, on_epoch=True, batch_size=len(batch), sync_dist=True, prog_bar=in_bar)
        return loss

    def _keep(self, prediction: Prediction, batch: Batch) -> None:
        self._steps.append((map_tensors(_to_cpu, prediction), map_tensors(_to_cpu, batch)))

    def _gather(self) -> tuple[Prediction, Batch]:
        """Return what the steps of all devices kept, and forget it."""
        predictions, batches = zip(*gather_devices(self._steps), strict=True)
        self._steps = []
        return map_tensors(_joined, *predictions), map_tensors(_joined, *batches)

    def _score(self, arrays: Mapping[str, np.ndarray], camera: Camera | None = None) -> tuple[Truth, Scores]:
        task = self.scenario.task
        truth = Truth.from_arrays(arrays, metric_dims=task.metric_dims, by_height=task.by_height, camera=camera)
        return truth, score(Predictions.from_arrays(arrays), truth)


def prediction_arrays(
    prediction: Prediction, targets: Targets, experiments: np.ndarray, clusters: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the arrays of predictions.npz without those of the probe, see `cophy.training.run.read_predictions`."""
    presence = targets.presence[:, None]
    tensors = {
        "initial": targets.initial,
        "presence": targets.presence,
        "target": targets.position,
        "stable": targets.stable,
        "position": torch.where(presence[..., None], prediction.position, 0.0),
        "pair": targets.pair,
        "cell": targets.cell,
    }
    if prediction.stable_logit is not None:
        tensors["stable_logit"] = torch.where(presence, prediction.stable_logit, 0.0)
    if prediction.confounder_estimate is not None:
        seen = targets.observed_presence[..., None]
        tensors["estimate"] = torch.where(seen, prediction.confounder_estimate, 0.0)
    if prediction.draw_variance is not None:
        tensors["draw_variance"] = torch.where(presence[..., None], prediction.draw_variance, 0.0)
    return {"experiment": experiments, "cluster": clusters} | {name: tensor.numpy() for name, tensor in tensors.items()}


def _to_cpu(tensor: Tensor) -> Tensor:
    """Copy to the CPU, at least in single precision: NumPy knows no bfloat16."""
    reduced = tensor.dtype in (torch.bfloat16, torch.float16)
    return tensor.float().cpu() if reduced else tensor.cpu()


def _joined(*parts: Tensor) -> Tensor:
    return torch.cat(parts)


def _confounder_heads(network: nn.Module, scenario: Scenario) -> nn.ModuleList:
    """Return linear classifiers of mass and of friction on every object's U (paper, appendix)."""
    width = estimate_dim(network)
    if not width:
        raise CophyError(
            "training.confounder_weight (ablation=supervised_confounders) needs a model that estimates confounders from AB, "
            "with an attribute estimate_dim"
        )
    grid = scenario.confounders
    return nn.ModuleList(nn.Linear(width, len(values)) for values in (grid.mass, grid.friction))
