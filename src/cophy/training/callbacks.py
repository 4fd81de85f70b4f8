"""What a training shows and says on its way."""

import logging
from pathlib import Path

import lightning as L
import torch
from lightning.pytorch.loggers import TensorBoardLogger

from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.training.figures import draw_error_over_time, draw_trajectories, error_over_time
from cophy.types import Batch

log = logging.getLogger(__name__)

NUM_SHOWN = 4  # experiments: two twin pairs, so that the same C is seen with two outcomes


class PredictionFigures(L.Callback):
    """TensorBoard figures of the first validation experiments, every few epochs and after the last."""

    def __init__(self, every_n_epochs: int) -> None:
        self.every_n_epochs = every_n_epochs

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        epoch = trainer.current_epoch + 1
        if trainer.sanity_checking or (epoch % self.every_n_epochs and epoch != trainer.max_epochs):
            return
        data, logger = trainer.datamodule, trainer.logger  # type: ignore[attr-defined]
        if not isinstance(data, CounterfactualDataModule) or not isinstance(logger, TensorBoardLogger):
            return
        shown = Batch(*(tensor[:NUM_SHOWN] for tensor in data.val.batch))
        with torch.no_grad():
            prediction = pl_module(Batch(*(tensor.to(pl_module.device) for tensor in shown)))
        initial, predicted, true, presence = (
            tensor.cpu().numpy() for tensor in (shown.initial, prediction.position, shown.target, shown.presence)
        )
        scenario = data.scenario
        error = error_over_time(predicted, true, presence, dims=scenario.task.metric_dims)
        colors = list(scenario.colors.values())
        figures = {
            "val/trajectories": draw_trajectories(initial, predicted, true, presence, colors=colors),
            "val/error_over_time": draw_error_over_time({"": error}, frame_rate_hz=scenario.clock.frame_rate_hz),
        }
        for name, figure in figures.items():
            logger.experiment.add_figure(name, figure, trainer.global_step)


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: go on with ckpt=%s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)
