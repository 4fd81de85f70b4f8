"""Pictures of what a de-renderer finds, for TensorBoard.

How TensorBoard names runs and values: results first, nothing that is constant.
When figures are drawn, and where they go.
A clip of twins below each other, or of one experiment: AB, the true CD and the predicted CD, drawn from positions.
Pictures of predictions, for TensorBoard.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor
from torch.utils.data import default_collate
from torch.utils.tensorboard import SummaryWriter

from cophy.dataset.frames import FrameDataset
from cophy.drawing.files import add_clip, mark
from cophy.drawing.plots import draw_centres, draw_confusion, draw_error_over_time, draw_trajectories, error_over_time
from cophy.drawing.sheets import REACH, Line, at, grid, text_block
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.training.predictor import PredictionModule
from cophy.types import Batch, Prediction, move_to, take

# TensorBoard has a card for each value, in the order of their names: with these, the first ones are results
RENAMED = {"val/mse": "mse/val", "test/mse": "mse/test"}
OF_CELL = "val/mse_"
CONSTANT = {"epoch", "train/stability_base_rate", "val/stability_base_rate"}  # a curve of these says nothing
COMPARED = ("mse", "twin_difference_explained", "right_twin_chosen", "sequence_stability_accuracy")  # of the test


class Curves(TensorBoardLogger):
    """Lightning's logger for TensorBoard, with cards in the order of what matters.

    Attributes:
        earlier: What lies in its folder already: curves of an earlier training of the same run.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.earlier = sorted(Path(self.log_dir).rglob("events.out.tfevents.*"))

    def forget_earlier(self) -> None:
        """Remove those curves: two trainings would be drawn as one line."""
        for path in self.earlier:
            path.unlink(missing_ok=True)
        self.earlier = []

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        super().log_metrics({shown_as(key): each for key, each in metrics.items() if key not in CONSTANT}, step)

    def log_results(self, results: Mapping[str, float], step: int) -> None:
        """What the test measured. With it, the run has its line in the table of hyperparameters.

        Args:
            results: Each measure's mean.
            step: Of the training.
        """
        self.log_metrics({f"test/{name}": value for name, value in results.items() if name not in COMPARED}, step)
        compared = {shown_as(f"test/{name}"): results[name] for name in COMPARED if name in results}
        known = {
            key: value
            for key, value in dict(self.hparams).items()
            if value not in (None, "") and not key.endswith("_target_")
        }
        super().log_hyperparams(known, compared, step)


def shown_as(name: str) -> str:
    """The name of a value's card: `val/mse` -> `mse/val`, `val/mse_` and a cell -> `per_cell/mse_` and the cell."""
    if name.startswith(OF_CELL):
        return f"per_cell/{name.removeprefix('val/')}"
    return RENAMED.get(name, f"train/{name}" if name.startswith("lr-") else name)


def writer_now(trainer: L.Trainer, every_n_epochs: int) -> SummaryWriter | None:
    """TensorBoard's writer where this validation is drawn: every few epochs, after the last, and where nothing is trained.

    None where it is not drawn, on all devices but the first, and where TensorBoard is not among the loggers.

    Args:
        trainer: Has just validated.
        every_n_epochs: How often is drawn.
    """
    logger = next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)
    if logger is None or trainer.sanity_checking or not trainer.is_global_zero:
        return None
    epoch, trains = trainer.current_epoch + 1, trainer.state.fn == TrainerFn.FITTING
    return logger.experiment if not trains or epoch % every_n_epochs == 0 or epoch == trainer.max_epochs else None


RESOLUTION = 224
NUM_FRAMES = 15  # every second of a sequence of 30: enough to follow what moves, and rendered in half the time
HEADINGS = ("AB: observed", "CD: true", "CD: predicted")
LABEL_PX = 70
UPRIGHT_XYZW = (0.0, 0.0, 0.0, 1.0)


class PredictionClip:
    """Draws predictions beside the truth, which is rendered only once.

    Shapes are the scenario's guess and nothing is turned, in all columns alike. All are cropped to where true objects move.

    Args:
        observed: (N, T, K, 3) positions in AB, metres.
        counterfactual: (N, T, K, 3) true positions in CD.
        observed_presence: (N, K) which slots hold an object in AB.
        presence: (N, K) which slots hold an object in CD.
        scenario: Whose objects and camera to draw with.
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
        self.times = np.linspace(0, num_frames - 1, min(NUM_FRAMES, num_frames)).astype(int)
        true = ((observed, observed_presence), (counterfactual, presence))
        places = [np.moveaxis(positions, 1, 2)[present].reshape(-1, 3) for positions, present in true]
        self.window = scenario.camera.window_around(np.concatenate(places), REACH * scenario.object_size_m)
        self.truth = [self._rendered(*each) for each in true]

    def of(self, predicted: np.ndarray) -> tuple[np.ndarray, float]:
        """(N, T, K, 3) predicted positions in CD -> frames (T', H, W, 3) uint8, and how many to show in a second."""
        columns, rate = [*self.truth, self._rendered(predicted, self.presence)], self.scenario.clock.frame_rate_hz
        said = [f"twin {n}" for n in range(1, len(predicted) + 1)] if len(predicted) > 1 else [""]
        names = [text_block([Line(name, bold=True)] if name else [], LABEL_PX) for name in said]
        frames = []
        for n, time in enumerate(self.times.tolist()):
            top = [text_block([Line(heading), Line(at(time, rate))], RESOLUTION) for heading in HEADINGS]
            rows = [[name, *(column[row][n] for column in columns)] for row, name in enumerate(names)]
            frames.append(grid([[text_block([], LABEL_PX), *top], *rows]))
        return np.stack(frames), rate * (len(self.times) - 1) / (predicted.shape[1] - 1)

    def _rendered(self, positions: np.ndarray, presence: np.ndarray) -> list[list[np.ndarray]]:
        """(N, T, K, 3) and (N, K) -> pictures of each experiment at the times that are shown."""
        shapes = [int(self.scenario.shape_from_positions)] * self.scenario.num_slots
        upright = np.broadcast_to(UPRIGHT_XYZW, (len(self.times), self.scenario.num_slots, 4))
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


NUM_SHOWN = 4  # experiments: two twin pairs, so that the same C is seen with two outcomes


class PredictionFigures(L.Callback):
    """TensorBoard pictures of the first validation experiments, every few epochs and after the last.

    Args:
        validated: All validation experiments.
        scenario: Theirs.
        every_n_epochs: How often.
    """

    def __init__(self, validated: Batch, scenario: Scenario, every_n_epochs: int) -> None:
        self.shown = take(validated, slice(NUM_SHOWN))
        self.drawn, self.every_n_epochs = DrawnPredictions(self.shown, scenario, "val"), every_n_epochs

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        writer = writer_now(trainer, self.every_n_epochs)
        if writer is None:
            return
        assert isinstance(pl_module, PredictionModule)
        assert isinstance(pl_module.dtype, torch.dtype)
        with torch.no_grad():
            prediction = pl_module(move_to(self.shown, pl_module.device, pl_module.dtype))
        self.drawn.add(writer, prediction, trainer.global_step)
        if pl_module.standing is not None:
            figure = draw_confusion(pl_module.standing, ("falls", "stands"))
            writer.add_figure("val/tower_stands", figure, trainer.global_step)


class DrawnPredictions:
    """Draws predictions of a few experiments into TensorBoard; what does not change is drawn only once.

    Args:
        shown: The experiments: twin pairs.
        scenario: Theirs.
        split: `val` or `test`, of which they are.
    """

    def __init__(self, shown: Batch, scenario: Scenario, split: str) -> None:
        self.shown, self.scenario, self.split = shown, scenario, split
        self.clip: PredictionClip | None = None

    def add(self, writer: SummaryWriter, prediction: Prediction, step: int) -> None:
        """Draw trajectories, the error over time, and a clip of one twin pair, or of one experiment.

        Args:
            writer: Of TensorBoard.
            prediction: Of the experiments.
            step: Of the training, where they are shown.
        """
        prediction, targets = move_to(prediction, torch.device("cpu"), torch.float32), self.shown.targets
        initial, predicted, true, presence = (
            tensor.numpy() for tensor in (targets.initial, prediction.position, targets.position, targets.presence)
        )
        error = error_over_time(predicted, true, presence, dims=self.scenario.task.metric_dims)
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
        if self.clip is None:
            sequences = self.shown.inputs.observed.numpy(), _whole(initial, true)
            seen = self.shown.inputs.observed_presence.numpy(), presence
            self.clip = PredictionClip(*(each[pair] for each in (*sequences, *seen)), scenario=self.scenario)
        frames, frames_per_second = self.clip.of(_whole(initial, predicted)[pair])
        add_clip(writer, f"{self.split}/clip", frames, frames_per_second=frames_per_second, step=step)

    def _pair(self) -> slice:
        """The twins among the shown whose true D differ most; one experiment where there are no twins (released data)."""
        position, pair = self.shown.targets.position, self.shown.targets.pair
        twins = pair[1:] == pair[:-1]
        if not twins.any():
            return slice(0, 1)
        apart = (position[1:] - position[:-1]).square().sum(dim=(1, 2, 3)) * twins
        first = int(apart.argmax())
        return slice(first, first + 2)


def _whole(initial: np.ndarray, later: np.ndarray) -> np.ndarray:
    """C and D as one sequence."""
    return np.concatenate([initial[:, None], later], axis=1)


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
