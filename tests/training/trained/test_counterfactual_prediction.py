"""What is not fit to be looked at, or to look, is refused by name; tests/end_to_end/test_pictures.py predicts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cophy.config import composed, to_plain
from cophy.errors import CophyError
from cophy.schemas import SCENARIOS
from cophy.training.trained import Counterfactual, TrainedDerenderer, TrainedPredictor, check_pair, predict
from tests.training.trained.saved import model_of, saved, weights_of

SEES = model_of("model=derenderer", "model.resolution=16", "model.width=2", "render.resolution=16")
KNOWS = model_of("model.hidden_dim=8")


def derenderer(folder: Path, **weights: float) -> TrainedDerenderer:
    """One that sees something everywhere, with other weights of these names."""
    return TrainedDerenderer(saved(folder / "sees.ckpt", SEES, filled(SEES, {"deviation": 0.0, **weights})))


def predictor(folder: Path, model: dict[str, Any] = KNOWS, **origin: Any) -> TrainedPredictor:
    return TrainedPredictor(saved(folder / "knows.ckpt", model, weights_of(model), **origin), SCENARIOS)


def filled(model: dict[str, Any], values: dict[str, float]) -> dict[str, Any]:
    weights = weights_of(model)
    weights["heads.geometry.4.bias"] += torch.tensor([0.0, 0.0, 0.0, 100.0])  # presence
    return weights | {name: torch.full_like(weights[name], value) for name, value in values.items()}


def looked_at(by: TrainedDerenderer, of: TrainedPredictor) -> Counterfactual:
    pictures = np.zeros((of.scenario.clock.num_frames, 16, 16, 3), np.uint8)
    return predict(pictures, pictures[0], by, of)


def test_what_is_not_finite_is_refused_with_the_checkpoint(tmp_path: Path) -> None:
    knows = predictor(tmp_path)
    assert np.isfinite(looked_at(derenderer(tmp_path), knows).positions).all()
    with pytest.raises(CophyError, match=r"derenderer=.*sees\.ckpt predicts what is not finite"):
        looked_at(derenderer(tmp_path, mean=float("nan")), knows)
    with torch.no_grad():
        next(knows.network.parameters()).fill_(float("nan"))
    with pytest.raises(CophyError, match=r"predictor=.*knows\.ckpt predicts what is not finite"):
        looked_at(derenderer(tmp_path), knows)


def test_a_predictor_of_another_length_is_named(tmp_path: Path) -> None:
    model = model_of("model.hidden_dim=8", "ablation=single_step") | {"num_frames": 10}
    with pytest.raises(CophyError, match=r"knows\.ckpt is no checkpoint of train\.py, or of another version"):
        looked_at(derenderer(tmp_path), predictor(tmp_path, model))


def test_two_checkpoints_know_the_same_objects(tmp_path: Path) -> None:
    scenario = to_plain(composed("train", "scenario=balls"))["scenario"]
    check_pair(derenderer(tmp_path), predictor(tmp_path))
    fewer = scenario | {"colors": dict(list(scenario["colors"].items())[:4])}
    with pytest.raises(CophyError, match=r"sees\.ckpt sees .*, predictor=.*knows\.ckpt knows "):
        check_pair(derenderer(tmp_path), predictor(tmp_path, scenario=fewer))
