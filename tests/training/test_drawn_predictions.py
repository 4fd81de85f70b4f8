"""What TensorBoard shows of predictions: twins, where there are any."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from cophy.scenario import Scenario
from cophy.training import figures
from cophy.training.figures import DrawnPredictions
from cophy.types import Prediction
from tests.models.networks import random_batch


class Writer:
    """Keeps nothing."""

    def add_figure(self, *_: object) -> None: ...


@pytest.mark.parametrize(("pairs", "num_rows"), [([0, 0, 1, 1], 2), ([0, 1, 2, 3], 1)], ids=["twins", "released"])
def test_the_clip_is_of_twins_or_of_one_experiment(
    pairs: list[int], num_rows: int, scenario_of: Callable[[str], Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, clips = scenario_of("balls"), []
    monkeypatch.setattr(figures, "add_clip", lambda writer, name, frames, **_: clips.append(frames))
    batch = random_batch(scenario.num_slots, [4] * 4, num_frames=30)
    shown = replace(batch, targets=replace(batch.targets, pair=torch.tensor(pairs)))
    prediction = Prediction(shown.targets.position, torch.zeros_like(shown.targets.position[..., 0]))
    DrawnPredictions(shown, scenario, "val").add(Writer(), prediction, 0)
    (frames,) = clips
    assert round(frames.shape[1] / 224) == num_rows
