"""What TensorBoard shows: results first, and clips of twins if there are any."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.data_provider import MultiplexerDataProvider
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.backend.event_processing.plugin_event_multiplexer import EventMultiplexer
from tensorboard.context import RequestContext
from tensorboard.plugins.base_plugin import TBContext
from tensorboard.plugins.hparams.api_pb2 import DataType
from tensorboard.plugins.hparams.backend_context import Context

from cophy.drawing import tensorboard
from cophy.drawing.tensorboard import Curves, DrawnPredictions
from cophy.scenario import Scenario
from cophy.types import Prediction
from tests.models.networks import random_batch


class Writer:
    """Keeps nothing."""

    def add_figure(self, *_: object) -> None: ...


def clips_of(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Return a list that gets the frames of every clip."""
    clips: list[np.ndarray] = []
    monkeypatch.setattr(tensorboard, "add_clip", lambda writer, name, frames, **_: clips.append(frames))
    return clips


def predictions_of(scenario: Scenario, pairs: list[int]) -> tuple[DrawnPredictions, Prediction]:
    batch = random_batch(scenario.num_slots, [4] * 4, num_frames=30)
    shown = replace(batch, targets=replace(batch.targets, pair=torch.tensor(pairs)))
    prediction = Prediction(shown.targets.position, torch.zeros_like(shown.targets.position[..., 0]))
    return DrawnPredictions(shown, scenario, "val"), prediction


@pytest.mark.parametrize(("pairs", "num_rows"), [([0, 0, 1, 1], 2), ([0, 1, 2, 3], 1)], ids=["twins", "released"])
def test_the_clip_is_of_twins_or_of_one_experiment(
    pairs: list[int], num_rows: int, scenario_of: Callable[[str], Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = clips_of(monkeypatch)
    drawn, prediction = predictions_of(scenario_of("balls"), pairs)
    drawn.add(Writer(), prediction, 0)
    (frames,) = clips
    assert round(frames.shape[1] / 224) == num_rows


def test_without_pybullet_one_line_says_that_there_is_no_clip(
    scenario_of: Callable[[str], Scenario], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clips = clips_of(monkeypatch)
    monkeypatch.setitem(sys.modules, "pybullet", None)  # as on Python 3.12, which has no wheels of it
    drawn, prediction = predictions_of(scenario_of("balls"), [0, 0, 1, 1])
    for step in range(3):
        drawn.add(Writer(), prediction, step)
    (message,) = caplog.messages
    assert message.startswith("TensorBoard gets no clip: simulation and rendering need PyBullet")
    assert not clips


def read_curves(directory: Path) -> EventAccumulator:
    curves = EventAccumulator(str(directory))
    curves.Reload()
    return curves


def test_the_first_card_is_a_result(tmp_path: Path) -> None:
    curves = Curves(str(tmp_path), name="", version="", default_hp_metric=False)
    curves.log_metrics({"epoch": 0, "train/loss": 1.0, "lr-Adam": 0.1, "val/mse": 2.0, "val/mse_both_stand": 3.0}, 5)
    curves.log_hyperparams({"model": "in", "nothing": None})
    curves.save()
    curves.log_results({"mse": 4.0, "pixel_error": 7.0}, 9)
    curves.save()
    events = read_curves(tmp_path)
    tags = sorted(events.Tags()["scalars"])
    assert tags == ["mse/test", "mse/val", "per_cell/mse_both_stand", "test/pixel_error", "train/loss", "train/lr-Adam"]
    assert [(event.step, event.value) for event in events.Scalars("mse/test")] == [(9, 4.0)]


def test_swept_keys_are_the_first_columns_of_the_table_of_hyperparameters(tmp_path: Path) -> None:
    """TensorBoard shows the first five at the start; one run was not part of the sweep."""
    names = {"ablation": "full", "batch_size": 64, "model": "in", "positions": "ground_truth", "scenario": "balls"}
    sweep = [{"training.learning_rate": rate, "width": width} for rate in (0.1, 0.2) for width in (8, 16)]
    for number, changes in enumerate([{}, *sweep]):
        curves = Curves(str(tmp_path), name=f"{number}", version="", default_hp_metric=False)
        curves.log_hyperparams({**names, "seed": 0, **changes})
        curves.log_results({"mse": 4.0, "twin_difference_explained": 0.5}, 9)
        curves.save()
        curves.experiment.close()
    multiplexer = EventMultiplexer().AddRunsFromDirectory(str(tmp_path))
    multiplexer.Reload()
    provider = MultiplexerDataProvider(multiplexer, str(tmp_path))
    table, request = Context(TBContext(data_provider=provider)), RequestContext()
    experiment = table.experiment_from_metadata(request, "", True, table.hparams_metadata(request, ""), [])
    columns = {info.name: info for info in experiment.hparam_infos}
    assert list(columns)[:2] == ["training.learning_rate", "width"]
    assert {DataType.Name(columns[name].type) for name in ("width", "seed")} == {"DATA_TYPE_FLOAT64"}
    assert experiment.metric_infos[0].name.tag == "mse/test"


def test_a_new_training_removes_the_curves_of_an_earlier_one(tmp_path: Path) -> None:
    for value in (1.0, 2.0):
        curves = Curves(str(tmp_path), name="", version="", default_hp_metric=False)
        curves.log_metrics({"val/mse": value}, 0)
        curves.remove_earlier()
        curves.save()
        curves.experiment.close()
    assert [event.value for event in read_curves(tmp_path).Scalars("mse/val")] == [2.0]
