"""Pictures of predictions, for TensorBoard."""

import lightning as L
import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from cophy.drawing.gifs import add_clip
from cophy.drawing.plots import draw_confusion, draw_error_over_time, draw_trajectories, error_over_time
from cophy.scenario import Scenario
from cophy.training.callbacks.drawing_times import writer_now
from cophy.training.callbacks.prediction_clip import PredictionClip
from cophy.training.prediction_module import PredictionModule
from cophy.types import Batch, Prediction, moved, take

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
            prediction = pl_module(moved(self.shown, pl_module.device, pl_module.dtype))
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
        prediction, targets = moved(prediction, torch.device("cpu"), torch.float32), self.shown.targets
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
