"""What TensorBoard shows: curves with results first, figures and clips of predictions and of de-rendered frames."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.trainer.states import TrainerFn
from tensorboard.compat.proto.summary_pb2 import Summary
from torch import Tensor
from torch.utils.data import default_collate
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.drawing.files import encode_gif, mark
from cophy.drawing.plots import draw_centres, draw_confusion, draw_error_over_time, draw_trajectories, error_over_time
from cophy.drawing.sheets import REACH, Line, at, grid, text_block
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.types import Batch, Prediction, move_to, take

log = logging.getLogger(__name__)

# TensorBoard sorts cards by name: with these names the first ones are results
CARD_NAMES = {"val/mse": "mse/val", "test/mse": "mse/test"}
CELL_PREFIX = "val/mse_"
CONSTANT = {"epoch", "val/stability_base_rate"}  # not shown as curves
TABLE_METRICS = (
    "mse",
    "twin_difference_explained",
    "right_twin_chosen",
    "sequence_stability_accuracy",
)  # in the table of hyperparameters


class Curves(TensorBoardLogger):
    """Lightning's logger for TensorBoard, with results first.

    Attributes:
        earlier: Files of an earlier training of the same run in its folder.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.earlier = sorted(Path(self.log_dir).rglob("events.out.tfevents.*"))

    def remove_earlier(self) -> None:
        """Remove the earlier curves: two trainings would be drawn as one line."""
        for path in self.earlier:
            path.unlink(missing_ok=True)
        self.earlier = []

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        super().log_metrics({card_name(key): each for key, each in metrics.items() if key not in CONSTANT}, step)

    def log_results(self, results: Mapping[str, float], step: int) -> None:
        """Log the mean of every test metric, and the run's line in the table of hyperparameters.

        Without a description of the columns, which would be that of one run for all, TensorBoard compares the runs and
        puts the keys whose values differ first.
        """
        self.log_metrics({f"test/{name}": value for name, value in results.items() if name not in TABLE_METRICS}, step)
        table = {card_name(f"test/{name}"): results[name] for name in TABLE_METRICS if name in results}
        hyperparameters = {
            key: value
            for key, value in dict(self.hparams).items()
            if value not in (None, "") and not key.endswith("_target_")
        }
        self.log_metrics(table, step)
        _, *summaries = hparams(self._sanitize_params(hyperparameters), table)  # type: ignore[no-untyped-call]
        for summary in summaries:  # the beginning of the run, with its values, and the end
            self.experiment._get_file_writer().add_summary(summary)


def card_name(name: str) -> str:
    """Return the name of a value's card, such as `mse/val` for `val/mse` and `per_cell/mse_both_stand` for a cell."""
    if name.startswith(CELL_PREFIX):
        return f"per_cell/{name.removeprefix('val/')}"
    return CARD_NAMES.get(name, f"train/{name}" if name.startswith("lr-") else name)


def figure_writer_if_due(trainer: L.Trainer, every_n_epochs: int) -> SummaryWriter | None:
    """Return TensorBoard's writer if this validation is drawn: every few epochs, after the last, and without training.

    Only the first device draws, and only with TensorBoard among the loggers.
    """
    logger = next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)
    if logger is None or trainer.sanity_checking or not trainer.is_global_zero:
        return None
    epoch, trains = trainer.current_epoch + 1, trainer.state.fn == TrainerFn.FITTING
    return logger.experiment if not trains or epoch % every_n_epochs == 0 or epoch == trainer.max_epochs else None


RESOLUTION = 224
CLIP_FRAMES = 15  # every second frame of 30: enough to follow motion, and rendered in half the time
HEADINGS = ("AB: observed", "CD: true", "CD: predicted")
NAME_PX = 70
_UPRIGHT_XYZW = (0.0, 0.0, 0.0, 1.0)


class PredictionClip:
    """Clip of AB, the true CD and the predicted CD in columns, drawn from positions; the truth is rendered only once.

    All columns show the shapes that the scenario guesses, without rotation, cropped to where true objects move.

    Args:
        observed: (N, T, K, 3) positions in AB, metres.
        counterfactual: (N, T, K, 3) true positions in CD.
        observed_presence: (N, K) presence in AB.
        presence: (N, K) presence in CD.
    """

    def __init__(
        self,
        observed: np.ndarray,
        counterfactual: np.ndarray,
        observed_presence: np.ndarray,
        presence: np.ndarray,
        *,
        scenario: Scenario,
    ) -> None:
        self.scenario, self.presence, num_frames = scenario, presence, observed.shape[1]
        self.times = np.linspace(0, num_frames - 1, min(CLIP_FRAMES, num_frames)).astype(int)
        true = ((observed, observed_presence), (counterfactual, presence))
        places = [np.moveaxis(positions, 1, 2)[present].reshape(-1, 3) for positions, present in true]
        self.window = scenario.camera.window_around(np.concatenate(places), REACH * scenario.object_size_m)
        self.truth = [self._rendered(*each) for each in true]

    def render(self, predicted: np.ndarray) -> tuple[np.ndarray, float]:
        """Render (N, T, K, 3) predicted positions in CD to frames (T', H, W, 3) uint8 and a frame rate in Hz."""
        columns, rate = [*self.truth, self._rendered(predicted, self.presence)], self.scenario.clock.frame_rate_hz
        titles = [f"twin {n}" for n in range(1, len(predicted) + 1)] if len(predicted) > 1 else [""]
        names = [text_block([Line(title, bold=True)] if title else [], NAME_PX) for title in titles]
        frames = []
        for n, time in enumerate(self.times.tolist()):
            top = [text_block([Line(heading), Line(at(time, rate))], RESOLUTION) for heading in HEADINGS]
            rows = [[name, *(column[row][n] for column in columns)] for row, name in enumerate(names)]
            frames.append(grid([[text_block([], NAME_PX), *top], *rows]))
        return np.stack(frames), rate * (len(self.times) - 1) / (predicted.shape[1] - 1)

    def _rendered(self, positions: np.ndarray, presence: np.ndarray) -> list[list[np.ndarray]]:
        """Render (N, T, K, 3) positions and (N, K) presence to images of each experiment at the times of the clip."""
        shapes = [int(self.scenario.shape_from_positions)] * self.scenario.num_slots
        upright = np.broadcast_to(_UPRIGHT_XYZW, (len(self.times), self.scenario.num_slots, 4))
        with Renderer(self.scenario, RESOLUTION) as renderer:
            whole = [
                renderer.render(places[self.times], upright, presence=present, shapes=shapes, background_seed=0).rgb
                for places, present in zip(positions, presence, strict=True)
            ]
        size = (RESOLUTION, RESOLUTION)
        return [
            [cv2.resize(frame, size, interpolation=cv2.INTER_CUBIC) for frame in self.window.cut(frames)]
            for frames in whole
        ]


NUM_DRAWN = 4  # experiments: two twin pairs, so that the same C is seen with two outcomes


class PredictionFigures(L.Callback):
    """Draws predictions of the first validation experiments, every few epochs and after the last."""

    def __init__(self, scenario: Scenario, every_n_epochs: int) -> None:
        self.scenario, self.every_n_epochs = scenario, every_n_epochs
        self.drawn: DrawnPredictions | None = None

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        writer = figure_writer_if_due(trainer, self.every_n_epochs)
        data = getattr(trainer, "datamodule", None)
        if writer is None or not isinstance(data, CounterfactualDataModule):
            return
        if self.drawn is None:
            self.drawn = DrawnPredictions(take(data.val.batch, slice(NUM_DRAWN)), self.scenario, "val")
        assert isinstance(pl_module.dtype, torch.dtype)
        with torch.no_grad():
            prediction = pl_module(move_to(self.drawn.batch, pl_module.device, pl_module.dtype))
        self.drawn.add(writer, prediction, trainer.global_step)
        standing = getattr(pl_module, "standing", None)
        if standing is not None:
            figure = draw_confusion(standing, ("falls", "stands"))
            writer.add_figure("val/tower_stands", figure, trainer.global_step)


class DrawnPredictions:
    """Draws predictions of a few experiments into TensorBoard; the truth is rendered only once.

    Args:
        batch: The experiments: twin pairs.
        split: `val` or `test`, the prefix of the figures' names.
    """

    def __init__(self, batch: Batch, scenario: Scenario, split: str) -> None:
        self.batch, self.scenario, self.split = batch, scenario, split
        self.clip: PredictionClip | None = None
        self.renders = True

    def add(self, writer: SummaryWriter, prediction: Prediction, step: int) -> None:
        """Draw trajectories, the error over time, and a clip of one twin pair, or of one experiment.

        Without PyBullet there is no clip; one line of the log says so.
        """
        prediction, targets = move_to(prediction, torch.device("cpu"), torch.float32), self.batch.targets
        initial, predicted, true, presence = (
            tensor.numpy() for tensor in (targets.initial, prediction.position, targets.position, targets.presence)
        )
        error = error_over_time(predicted, true, presence, dims=self.scenario.task.metric_dims).mean(axis=0)
        rate, colors = self.scenario.clock.frame_rate_hz, list(self.scenario.colors.values())
        figures = {
            "trajectories": draw_trajectories(initial, predicted, true, presence, colors=colors),
            "error_over_time": draw_error_over_time(
                {"": error}, frame_rate_hz=rate, title=f"mean of {len(initial)} experiments"
            ),
        }
        for name, figure in figures.items():
            writer.add_figure(f"{self.split}/{name}", figure, step)
        pair = self._pair()
        if self.clip is None and self.renders:
            sequences = self.batch.inputs.observed.numpy(), _join(initial, true)
            masks = self.batch.inputs.observed_presence.numpy(), presence
            try:
                self.clip = PredictionClip(*(each[pair] for each in (*sequences, *masks)), scenario=self.scenario)
            except CophyError as error:
                self.renders = False
                log.warning("TensorBoard gets no clip: %s", error)
        if self.clip is None:
            return
        frames, frames_per_second = self.clip.render(_join(initial, predicted)[pair])
        add_clip(writer, f"{self.split}/clip", frames, frames_per_second=frames_per_second, step=step)

    def _pair(self) -> slice:
        """Return the twins whose true D differ most, or one experiment if there are no twins (released data)."""
        position, pair = self.batch.targets.position, self.batch.targets.pair
        twins = (pair[1:] == pair[:-1]) & (pair[1:] >= 0)
        if not twins.any():
            return slice(0, 1)
        distance = (position[1:] - position[:-1]).square().sum(dim=(1, 2, 3)) * twins
        first = int(distance.argmax())
        return slice(first, first + 2)


def _join(initial: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Join C and D to one sequence."""
    return np.concatenate([initial[:, None], later], axis=1)


NUM_FRAMES_DRAWN = 8
MIN_CLIP_PX = 336


class DerenderingFigures(L.Callback):
    """Draws true and predicted centres in validation frames, and a clip of one sequence, every few epochs."""

    def __init__(self, every_n_epochs: int) -> None:
        self.every_n_epochs = every_n_epochs

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        writer = figure_writer_if_due(trainer, self.every_n_epochs)
        data = getattr(trainer, "datamodule", None)
        if writer is None or not isinstance(data, FrameDataModule):
            return
        frames, camera, count = data.val, data.scenario.camera, len(data.val)
        items = np.linspace(0, count - 1, min(NUM_FRAMES_DRAWN, count)).astype(int)
        batch = default_collate([frames[item] for item in items.tolist()])
        truth = batch.position.numpy(), batch.presence.numpy()
        centres = draw_centres(*_derender(pl_module, batch.image), *truth, camera=camera)
        writer.add_figure("val/centres", centres, trainer.global_step)
        clip, position, present = _derender(pl_module, frames.sequence_of(0).image)
        larger = max(1, MIN_CLIP_PX // clip.shape[1])
        clip = clip.repeat(larger, axis=1).repeat(larger, axis=2)
        marked = mark(clip, position, present, camera=camera, marker=cv2.MARKER_TILTED_CROSS)
        rate = data.scenario.clock.frame_rate_hz
        add_clip(writer, "val/clip", marked, frames_per_second=rate, step=trainer.global_step)


def _derender(module: L.LightningModule, image: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """De-render (N, 3, R, R) uint8 to arrays: images (N, R, R, 3), positions (N, K, 3) and presence (N, K)."""
    with torch.no_grad():
        output = module(image.to(module.device))
    return image.permute(0, 2, 3, 1).numpy(), output.position.cpu().numpy(), (output.presence_logit > 0).cpu().numpy()


def add_clip(writer: SummaryWriter, name: str, frames: np.ndarray, *, frames_per_second: float, step: int) -> None:
    """Add a clip (T, H, W, 3) uint8 to TensorBoard's images (`add_video` needs an old moviepy) at a step of the training."""
    content = encode_gif(frames, frames_per_second=frames_per_second)
    image = Summary.Image(height=frames.shape[1], width=frames.shape[2], colorspace=3, encoded_image_string=content)
    writer._get_file_writer().add_summary(Summary(value=[Summary.Value(tag=name, image=image)]), step)  # type: ignore[no-untyped-call]
