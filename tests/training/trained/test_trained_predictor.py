"""Checkpoints that somebody else wrote: predictors of cophy.models alone are loaded, and nothing else is imported."""

from pathlib import Path
from typing import Any

import pytest
import torch

from cophy.config import composed, to_plain
from cophy.errors import CophyError
from cophy.schemas import SCENARIOS
from cophy.training.trained import TrainedPredictor
from tests.training.trained.saved import NONSENSE, model_of, saved, weights_of

SAYS = r"a\.ckpt is no checkpoint of train\.py, or of another version of cophy \("


def test_a_checkpoint_brings_its_network_and_its_scenario(tmp_path: Path) -> None:
    model = model_of("model.hidden_dim=8")
    weights = weights_of(model)
    predictor = TrainedPredictor(saved(tmp_path / "a.ckpt", model, weights), SCENARIOS)
    assert (predictor.scenario.name, predictor.size, predictor.data_seed) == ("balls", "small", 0)
    assert all(torch.equal(value, weights[key]) for key, value in predictor.network.state_dict().items())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"_target_": "os.system"}, "only predictors of cophy.models are loaded"),
        ({"_target_": "cophy.training.trained.derender"}, "only predictors of cophy.models are loaded"),
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
    path = saved(tmp_path / "a.ckpt", model | changes, weights_of(model))
    with pytest.raises(CophyError, match=message):
        TrainedPredictor(path, SCENARIOS)


@pytest.mark.parametrize(("changes", "message"), NONSENSE)
def test_an_origin_that_says_nonsense_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path / "a.ckpt", model_of(), {}, **changes)
    with pytest.raises(CophyError, match=SAYS + ".*" + message):
        TrainedPredictor(path, SCENARIOS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nosuch": 1}, "Key 'nosuch' not in 'Balls'"),
        ({"clock": {"num_frames": 30, "frame_rate_hz": 0, "state_rate_hz": 20}}, "clock: state_rate_hz must be a mult"),
        ({"colors": {"red": "${oc.env:HOME}"}}, r"\$\{oc.env:HOME\} is a reference, whose value it has to say instead"),
        ({"colors": {"red": "???"}}, "Missing mandatory value"),
        ({"gravity_z": "down"}, "Value 'down' of type 'str' could not be converted to Float"),
    ],
)
def test_a_scenario_that_cannot_be_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    scenario = to_plain(composed("train", "scenario=balls"))["scenario"]
    model = model_of("model.hidden_dim=8")
    path = saved(tmp_path / "a.ckpt", model, weights_of(model), scenario=scenario | changes)
    with pytest.raises(CophyError, match=SAYS + ".*" + message):
        TrainedPredictor(path, SCENARIOS)


def test_a_scenario_that_is_not_known_is_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", model_of(), {}, scenario={"name": [1]})
    with pytest.raises(CophyError, match=r"a\.ckpt is of the scenario \[1\], which is not known here"):
        TrainedPredictor(path, SCENARIOS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hidden_dim": -1}, "model.hidden_dim=-1 must be at least 1"),
        ({"hidden_dim": "wide"}, ""),
        ({"gru_layers": 10**9}, "model.gru_layers=1000000000 is more than 16384"),
        ({"gating": "often"}, "model.gating=often must be one of per_step, static"),
        ({"interaction": "mlp"}, "model.interaction=mlp needs model.slots"),
        ({"more": 1}, "unexpected keyword argument 'more'"),
    ],
)
def test_a_network_that_cannot_be_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    model = model_of("model.hidden_dim=8")
    path = saved(tmp_path / "a.ckpt", model | changes, weights_of(model))
    with pytest.raises(CophyError, match=SAYS + ".*" + message):
        TrainedPredictor(path, SCENARIOS)


def test_weights_that_are_none_are_named(tmp_path: Path) -> None:
    model = model_of("model.hidden_dim=8")
    weights = weights_of(model)
    for wrong in ({"a": "text"}, weights | {"decoder.to_displacement.bias": torch.ones(3).to("meta")}):
        with pytest.raises(CophyError, match=SAYS):
            TrainedPredictor(saved(tmp_path / "a.ckpt", model, wrong), SCENARIOS)
    torch.save({"origin": {}, "state_dict": {1: torch.ones(3)}}, tmp_path / "a.ckpt")
    with pytest.raises(CophyError, match=r"a\.ckpt is no checkpoint of train\.py, or a damaged one"):
        TrainedPredictor(tmp_path / "a.ckpt", SCENARIOS)
