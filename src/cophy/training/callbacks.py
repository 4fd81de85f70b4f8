"""What a training shows and says on its way."""

import logging
from operator import itemgetter
from pathlib import Path

import cv2
import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor
from torch.utils.data import default_collate

from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.training.clips import add_clip, mark
from cophy.training.figures import draw_centres, draw_error_over_time, draw_trajectories, error_over_time
from cophy.types import map_fields

log = logging.getLogger(__name__)

NUM_FRAMES_SHOWN = 8
SMALLEST_CLIP_PX = 336
NUM_SHOWN = 4  # experiments: two twin pairs, so that the same C is seen with two outcomes


class PredictionFigures(L.Callback):
    """TensorBoard figures of the first validation experiments, every few epochs and after the last."""

    def __init__(self, every_n_epochs: int) -> None:
        self.every_n_epochs = every_n_epochs

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if not _is_time(trainer, self.every_n_epochs):
            return
        data, logger = trainer.datamodule, trainer.logger  # type: ignore[attr-defined]
        if not isinstance(data, CounterfactualDataModule) or not isinstance(logger, TensorBoardLogger):
            return
        shown = map_fields(itemgetter(slice(NUM_SHOWN)), data.val.batch)
        with torch.no_grad():
            prediction = pl_module(map_fields(lambda tensor: tensor.to(pl_module.device), shown))
        initial, predicted, true, presence = (
            tensor.cpu().numpy()
            for tensor in (shown.target_initial, prediction.position, shown.target, shown.target_presence)
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


class DerenderingFigures(L.Callback):
    """TensorBoard pictures of validation frames with true and predicted centres, and a clip of one sequence with these."""

    def __init__(self, every_n_epochs: int) -> None:
        self.every_n_epochs = every_n_epochs

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        data, logger = trainer.datamodule, trainer.logger  # type: ignore[attr-defined]
        if not _is_time(trainer, self.every_n_epochs) or not isinstance(logger, TensorBoardLogger):
            return
        assert isinstance(data, FrameDataModule)
        chosen = np.linspace(0, len(data.val) - 1, min(NUM_FRAMES_SHOWN, len(data.val))).astype(int)
        scattered = default_collate([data.val[item] for item in chosen.tolist()])
        images, position, present = _derender(pl_module, scattered.image)
        centres = draw_centres(
            images,
            position,
            present,
            scattered.position.numpy(),
            scattered.presence.numpy(),
            camera=data.scenario.camera,
        )
        logger.experiment.add_figure("val/centres", centres, trainer.global_step)
        clip, position, present = _derender(pl_module, data.val.sequence_of(0).image)
        larger = max(1, SMALLEST_CLIP_PX // clip.shape[1])
        clip = clip.repeat(larger, axis=1).repeat(larger, axis=2)
        marked = mark(clip, position, present, camera=data.scenario.camera, marker=cv2.MARKER_TILTED_CROSS)
        rate = data.scenario.clock.frame_rate_hz
        add_clip(logger.experiment, "val/clip", marked, frames_per_second=rate, step=trainer.global_step)


def _derender(module: L.LightningModule, image: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3, R, R) uint8 -> pictures (N, R, R, 3), positions (N, K, 3) and presence (N, K) as arrays."""
    with torch.no_grad():
        found = module(image.to(module.device))
    return image.permute(0, 2, 3, 1).numpy(), found.position.cpu().numpy(), (found.presence_logit > 0).cpu().numpy()


def _is_time(trainer: L.Trainer, every_n_epochs: int) -> bool:
    epoch = trainer.current_epoch + 1
    return not trainer.sanity_checking and (epoch % every_n_epochs == 0 or epoch == trainer.max_epochs)


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: go on with ckpt=%s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)
