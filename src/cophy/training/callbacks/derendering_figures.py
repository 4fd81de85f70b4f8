"""Pictures of what a de-renderer finds, for TensorBoard."""

import cv2
import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import default_collate

from cophy.dataset.feed.frame_dataset import FrameDataset
from cophy.drawing.gifs import add_clip, mark
from cophy.drawing.plots import draw_centres
from cophy.scenario import Scenario
from cophy.training.callbacks.drawing_times import writer_now

NUM_FRAMES_SHOWN = 8
MIN_CLIP_PX = 336


class DerenderingFigures(L.Callback):
    """TensorBoard pictures of frames with true and predicted centres, and a clip of one sequence with these.

    Args:
        frames: Validation frames.
        scenario: Theirs.
        every_n_epochs: How often, and after the last epoch.
    """

    def __init__(self, frames: FrameDataset, scenario: Scenario, every_n_epochs: int) -> None:
        self.frames, self.scenario, self.every_n_epochs = frames, scenario, every_n_epochs

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        writer, camera = writer_now(trainer, self.every_n_epochs), self.scenario.camera
        if writer is None:
            return
        count = len(self.frames)
        chosen = np.linspace(0, count - 1, min(NUM_FRAMES_SHOWN, count)).astype(int)
        shown = default_collate([self.frames[item] for item in chosen.tolist()])
        truth = shown.position.numpy(), shown.presence.numpy()
        centres = draw_centres(*_derender(pl_module, shown.image), *truth, camera=camera)
        writer.add_figure("val/centres", centres, trainer.global_step)
        clip, position, present = _derender(pl_module, self.frames.sequence_of(0).image)
        larger = max(1, MIN_CLIP_PX // clip.shape[1])
        clip = clip.repeat(larger, axis=1).repeat(larger, axis=2)
        marked = mark(clip, position, present, camera=camera, marker=cv2.MARKER_TILTED_CROSS)
        rate = self.scenario.clock.frame_rate_hz
        add_clip(writer, "val/clip", marked, frames_per_second=rate, step=trainer.global_step)


def _derender(module: L.LightningModule, image: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3, R, R) uint8 -> pictures (N, R, R, 3), positions (N, K, 3) and presence (N, K) as arrays."""
    with torch.no_grad():
        found = module(image.to(module.device))
    return image.permute(0, 2, 3, 1).numpy(), found.position.cpu().numpy(), (found.presence_logit > 0).cpu().numpy()
