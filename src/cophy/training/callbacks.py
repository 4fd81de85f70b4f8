"""What a training shows and says on its way."""

import logging
import math
import os
import signal
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import lightning as L
import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor
from torch.utils.data import default_collate

from cophy.dataset.feed.frame_dataset import FrameDataset
from cophy.drawing.gifs import add_clip, mark
from cophy.drawing.plots import draw_centres, draw_error_over_time, draw_trajectories, error_over_time
from cophy.scenario import Scenario
from cophy.training.trained.checkpoints import ORIGIN, Origin
from cophy.types import Batch, moved

log = logging.getLogger(__name__)

NUM_FRAMES_SHOWN = 8
MIN_CLIP_PX = 336
NUM_SHOWN = 4  # experiments: two twin pairs, so that the same C is seen with two outcomes


class PredictionFigures(L.Callback):
    """TensorBoard figures of some experiments, every few epochs and after the last.

    Args:
        shown: Validation experiments.
        scenario: Theirs.
        every_n_epochs: How often.
    """

    def __init__(self, shown: Batch, scenario: Scenario, every_n_epochs: int) -> None:
        self.shown, self.scenario, self.every_n_epochs = shown, scenario, every_n_epochs

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        logger, task, clock = _tensorboard(trainer), self.scenario.task, self.scenario.clock
        if not _is_time(trainer, self.every_n_epochs) or logger is None:
            return
        with torch.no_grad():
            assert isinstance(pl_module.dtype, torch.dtype)
            prediction = pl_module(moved(self.shown, pl_module.device, pl_module.dtype))
        prediction, targets = moved(prediction, torch.device("cpu"), torch.float32), self.shown.targets
        initial, predicted, true, presence = (
            tensor.numpy() for tensor in (targets.initial, prediction.position, targets.position, targets.presence)
        )
        error = error_over_time(predicted, true, presence, dims=task.metric_dims)
        colors = list(self.scenario.colors.values())
        figures = {
            "val/trajectories": draw_trajectories(initial, predicted, true, presence, colors=colors),
            "val/error_over_time": draw_error_over_time({"": error}, frame_rate_hz=clock.frame_rate_hz),
        }
        for name, figure in figures.items():
            logger.experiment.add_figure(name, figure, trainer.global_step)


class DerenderingFigures(L.Callback):
    """TensorBoard pictures of frames with true and predicted centres, and a clip of one sequence with these.

    Args:
        frames: Validation frames.
        scenario: Theirs.
        every_n_epochs: How often, and after the last epoch.
    """

    def __init__(self, frames: FrameDataset, scenario: Scenario, every_n_epochs: int) -> None:
        self.frames, self.scenario, self.every_n_epochs = frames, scenario, every_n_epochs

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        logger, camera = _tensorboard(trainer), self.scenario.camera
        if not _is_time(trainer, self.every_n_epochs) or logger is None:
            return
        count = len(self.frames)
        chosen = np.linspace(0, count - 1, min(NUM_FRAMES_SHOWN, count)).astype(int)
        shown = default_collate([self.frames[item] for item in chosen.tolist()])
        truth = shown.position.numpy(), shown.presence.numpy()
        centres = draw_centres(*_derender(pl_module, shown.image), *truth, camera=camera)
        logger.experiment.add_figure("val/centres", centres, trainer.global_step)
        clip, position, present = _derender(pl_module, self.frames.sequence_of(0).image)
        larger = max(1, MIN_CLIP_PX // clip.shape[1])
        clip = clip.repeat(larger, axis=1).repeat(larger, axis=2)
        marked = mark(clip, position, present, camera=camera, marker=cv2.MARKER_TILTED_CROSS)
        rate = self.scenario.clock.frame_rate_hz
        add_clip(logger.experiment, "val/clip", marked, frames_per_second=rate, step=trainer.global_step)


def _derender(module: L.LightningModule, image: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3, R, R) uint8 -> pictures (N, R, R, 3), positions (N, K, 3) and presence (N, K) as arrays."""
    with torch.no_grad():
        found = module(image.to(module.device))
    return image.permute(0, 2, 3, 1).numpy(), found.position.cpu().numpy(), (found.presence_logit > 0).cpu().numpy()


def _tensorboard(trainer: L.Trainer) -> TensorBoardLogger | None:
    return next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)


def _is_time(trainer: L.Trainer, every_n_epochs: int) -> bool:
    epoch = trainer.current_epoch + 1
    return not trainer.sanity_checking and (epoch % every_n_epochs == 0 or epoch == trainer.max_epochs)


class SaveOrigin(L.Callback):
    """Write into every checkpoint what it was trained as."""

    def __init__(self, origin: Origin) -> None:
        self.origin = origin

    def on_save_checkpoint(self, trainer: L.Trainer, pl_module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint[ORIGIN] = asdict(self.origin)


class BestValidation(L.Callback):
    """Remembers the validation metrics of the epoch with the best val/mse, whose weights are tested.

    Args:
        checkpoint: Of that epoch. Where it is gone, so are its metrics.
    """

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint
        self.metrics: dict[str, float] = {}

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
        if not trainer.sanity_checking and found["val/mse"] < self.metrics.get("val/mse", math.inf):
            self.metrics = found

    def state_dict(self) -> dict[str, Any]:
        return self.metrics

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.metrics = dict(state_dict) if self.checkpoint.exists() else {}


class BestCheckpoint(ModelCheckpoint):
    """Goes on with the best one so far, also where the run's directory was moved or a longer training has one of its own."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        best = str(Path(self.dirpath or "") / "best.ckpt")
        if Path(best).exists() and state_dict["best_model_path"]:
            scores = dict.fromkeys([best], state_dict["best_model_score"])
            paths = {"dirpath": self.dirpath, "best_model_path": best, "kth_best_model_path": best}
            state_dict = {**state_dict, **paths, "best_k_models": scores}
        super().load_state_dict(state_dict)


class Stopwatch(L.Callback):
    """Counts the seconds of a training, those before it was stopped included."""

    def __init__(self) -> None:
        self._before, self._start = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """So far."""
        return self._before + time.monotonic() - self._start

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._start = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._before = state_dict["seconds"]


class SubmititsSignals(L.Callback):
    """On a cluster, submitit ignores SIGTERM and waits for the signal that queues the job again; Lightning would end it."""

    def __init__(self) -> None:
        self.of_submitit = signal.getsignal(signal.SIGTERM) if "SUBMITIT_EXECUTOR" in os.environ else None

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if self.of_submitit is not None:
            signal.signal(signal.SIGTERM, self.of_submitit)


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: the same command goes on from %s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)
