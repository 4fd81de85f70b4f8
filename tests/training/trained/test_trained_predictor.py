"""Checkpoints that somebody else wrote: predictors of cophy.models alone are loaded, and nothing else is imported."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch

from cophy.app.composition import composed, to_plain
from cophy.app.schemas.registration import SCENARIOS
from cophy.errors import CophyError
from cophy.training.trained.checkpoints import Origin
from cophy.training.trained.network import build_network
from cophy.training.trained.trained_predictor import TrainedPredictor

PARTS = ("training", "scenario", "split", "size", "data_seed", "positions", "num_objects", "render")


def saved(path: Path, model: dict[str, Any], weights: dict[str, Any], /, **changes: Any) -> Path:
    """A checkpoint of this model."""
    plain = to_plain(composed("train", "scenario=balls"))
    origin = asdict(Origin(model, **{part: plain[part] for part in PARTS}, trained_on=[]))
    torch.save({"origin": origin | changes, "state_dict": {f"network.{k}": v for k, v in weights.items()}}, path)
    return path


def model_of(*overrides: str) -> dict[str, Any]:
    return to_plain(composed("train", "scenario=balls", *overrides))["model"]


def test_a_checkpoint_brings_its_network_and_its_scenario(tmp_path: Path) -> None:
    model = model_of("model.hidden_dim=8")
    weights = build_network(model).state_dict()
    predictor = TrainedPredictor(saved(tmp_path / "a.ckpt", model, weights), SCENARIOS)
    assert (predictor.scenario.name, predictor.size, predictor.data_seed) == ("balls", "small", 0)
    assert all(torch.equal(value, weights[key]) for key, value in predictor.network.state_dict().items())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"_target_": "os.system"}, "only predictors of cophy.models are loaded"),
        ({"_target_": "cophy.training.trained.derendering.derender"}, "only predictors of cophy.models are loaded"),
        ({"_target_": "cophy.models.derenderer.Derenderer"}, "only predictors of cophy.models are loaded"),
        ({"_target_": "cophy.models.cophynet.torch.hub.load"}, "cannot be imported|is not a torch.nn.Module"),
        ({"confounders": "ground_truth"}, "wants the true confounders"),
        ({"object_type": True}, "has model.object_type=true, which no de-renderer estimates"),
        ({"pose": True}, "has model.pose=true, which no de-renderer estimates"),
        ({"hidden_dim": 4}, "does not fit cophy.models.cophynet.CoPhyNet as it is now"),
        ({"_partial_": True}, "is no argument of a network"),
    ],
)
def test_a_checkpoint_of_anything_else_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    model = model_of("model.hidden_dim=8")
    path = saved(tmp_path / "a.ckpt", model | changes, build_network(model).state_dict())
    with pytest.raises(CophyError, match=message):
        TrainedPredictor(path, SCENARIOS)


@pytest.mark.parametrize("changes", [{"scenario": "balls"}, {"model": {}}, {"more": 1}])
def test_an_origin_that_lacks_something_is_damaged(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = saved(tmp_path / "a.ckpt", model_of(), {}, **changes)
    with pytest.raises(CophyError, match=r"is no checkpoint of train\.py"):
        TrainedPredictor(path, SCENARIOS)
