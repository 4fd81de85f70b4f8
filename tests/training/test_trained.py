"""Predictors and de-renderers from checkpoints that anybody may have written, and what is predicted with both."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cophy.config import generated_by, settings
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.models.baselines import CopyC
from cophy.scenario import Shape
from cophy.schemas import SCENARIOS
from cophy.training.trained import (
    DERENDERER,
    Counterfactual,
    TrainedDerenderer,
    TrainedPredictor,
    check_pair,
    find_derenderer,
    predict,
)
from tests.training.saved import NONSENSE, model_of, plain_settings, saved, weights_of

MISFIT = r"a\.ckpt was not written by train\.py, or by another version of cophy \(.*"
RENDER = {"modalities": ["rgb"], "resolution": 16, "backend": "tiny"}
IMAGE = np.zeros((1, 16, 16, 3), np.uint8)
SMALL = model_of("model.hidden_dim=8")
SMALL_DERENDERER = model_of("model=derenderer", "model.resolution=16", "model.width=2", "render.resolution=16")


def balls(data_seed: int = 0) -> States:
    """Return the balls of a dataset; nothing is generated."""
    return generated_by(settings("generate", "scenario=balls", "size=tiny", f"data_seed={data_seed}"))[0]


def predictor_of(path: Path) -> TrainedPredictor:
    return TrainedPredictor(path, SCENARIOS)


def test_a_checkpoint_holds_its_network_and_its_scenario(tmp_path: Path) -> None:
    weights = weights_of(SMALL)
    predictor = predictor_of(saved(tmp_path / "a.ckpt", SMALL, weights))
    assert (predictor.scenario.name, predictor.size, predictor.data_seed) == ("balls", "small", 0)
    assert all(torch.equal(value, weights[key]) for key, value in predictor.network.state_dict().items())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"_target_": "os.system"},
            r"of os\.system, whose code runs only if you name it: append model_class=os\.system",
        ),
        ({"_target_": "cophy.training.trained.derender"}, r"whose code runs only if you name it"),
        ({"_target_": "drift.Drift; run me"}, "model._target_ is not the name of a class"),
        ({"_target_": DERENDERER}, "is a checkpoint of a de-renderer, not of a predictor"),
        ({"_target_": "cophy.models.cophynet.torch.hub.load"}, "cannot be imported"),
        ({"confounders": "ground_truth"}, "needs the true confounders"),
        ({"hidden_dim": 4}, "does not fit cophy.models.cophynet.CoPhyNet as it is now"),
        ({"_partial_": True}, "is not an argument of a network"),
        ({"hidden_dim": "wide"}, r"a\.ckpt was not written"),
        ({"gru_layers": 10**9}, "model.gru_layers=1000000000 is more than 16384"),
        ({"gating": "often"}, "model.gating=often"),
        ({"more": 1}, "'more'"),
        ({"num_frames": 10}, "num_frames=10"),
    ],
)
def test_a_checkpoint_of_anything_else_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL | changes, weights_of(SMALL))
    with pytest.raises(CophyError, match=message):
        predictor_of(path)


def test_a_predictor_sees_the_poses_that_it_declares_and_no_derenderer_goes_with_it(tmp_path: Path) -> None:
    model = SMALL | {"pose": True}
    predictor = predictor_of(saved(tmp_path / "a.ckpt", model, weights_of(model)))
    generator, slots = torch.Generator().manual_seed(0), len(predictor.scenario.colors)
    states = torch.randn(2, 2, 117, slots, 13, generator=generator)
    states[..., 3:7] /= states[..., 3:7].norm(dim=-1, keepdim=True)
    experiments = {
        "states": states,
        "presence": torch.ones(2, 2, slots, dtype=torch.bool),
        "shape": torch.full((2, slots), int(Shape.CYLINDER)),
    }
    turned = states.clone()
    turned[:, 0, 0, :, 3:7] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    difference = predictor(experiments) - predictor(experiments | {"states": turned})
    assert difference.abs().max() > 1e-5
    with pytest.raises(CophyError, match=r"a\.ckpt has model\.pose=true, which no de-renderer estimates"):
        check_pair(make_derenderer(tmp_path), predictor)


class Scaled(CopyC):
    """A model of the user."""

    def __init__(self, *, seed: int) -> None:
        super().__init__()
        self.scale, self.seed = torch.nn.Parameter(torch.ones(())), seed


def test_a_model_of_the_user_is_loaded_if_its_class_is_named(tmp_path: Path) -> None:
    model = {"_target_": "moved.elsewhere.Scaled", "seed": 10**6}
    path = saved(tmp_path / "a.ckpt", model, {"scale": torch.tensor(3.0)})
    with pytest.raises(CophyError, match=r"append model_class=moved\.elsewhere\.Scaled"):
        predictor_of(path)
    with pytest.raises(CophyError, match=r"of moved\.elsewhere\.Scaled, not of model_class=CopyC"):
        TrainedPredictor(path, SCENARIOS, CopyC)
    network = TrainedPredictor(path, SCENARIOS, Scaled).network
    assert (type(network), network.scale.item(), network.seed, network.training) == (Scaled, 3.0, 10**6, False)
    for change, weights in (({"sed": 1}, {"scale": torch.ones(())}), ({}, {"scale": torch.ones(2)})):
        with pytest.raises(CophyError, match=MISFIT):
            TrainedPredictor(saved(path, model | change, weights), SCENARIOS, Scaled)


@pytest.mark.parametrize(("changes", "message"), NONSENSE)
def test_an_origin_that_makes_no_sense_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL, {}, **changes)
    for load in (predictor_of, TrainedDerenderer):
        with pytest.raises(CophyError, match=MISFIT + message):
            load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nosuch": 1}, "Key 'nosuch' not in 'Balls'"),
        ({"clock": {"num_frames": 30, "frame_rate_hz": 0, "state_rate_hz": 20}}, "clock: state_rate_hz must be a mult"),
        ({"colors": {"red": "${oc.env:HOME}"}}, "is a reference"),
        ({"colors": {"red": "???"}}, "Missing mandatory value"),
        ({"gravity_z": "down"}, "Value 'down' of type 'str' could not be converted to Float"),
    ],
)
def test_a_scenario_that_cannot_be_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    scenario = plain_settings()["scenario"]
    path = saved(tmp_path / "a.ckpt", SMALL, weights_of(SMALL), scenario=scenario | changes)
    with pytest.raises(CophyError, match=MISFIT + message):
        predictor_of(path)


def test_an_unknown_scenario_is_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL, {}, scenario={"name": "pendulum"})
    with pytest.raises(CophyError, match=r"a\.ckpt was trained on the scenario pendulum"):
        predictor_of(path)


def test_weights_without_values_are_refused(tmp_path: Path) -> None:
    weights = weights_of(SMALL)
    name = min(weights)
    with pytest.raises(CophyError, match=r"a\.ckpt"):
        predictor_of(saved(tmp_path / "a.ckpt", SMALL, weights | {name: weights[name].to("meta")}))


def test_without_a_derenderer_the_error_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no de-renderer of balls with 4 objects .* model=derenderer scenario=balls"):
        find_derenderer(tmp_path, [balls()], {4}, "4to4")


def test_a_run_without_readable_weights_hides_no_other_derenderer(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = tmp_path / "balls" / "4to4" / "derenderer" / "full" / "ground_truth" / "seed0"
    run.mkdir(parents=True)
    (run / "metrics.json").write_text("{}")
    with pytest.raises(CophyError, match="no de-renderer of balls with 4 objects"):
        find_derenderer(tmp_path, [balls()], {4}, "4to4")
    assert "a de-renderer is left out" in caplog.text


@pytest.mark.parametrize("data_seed", [0, 1])
def test_the_derenderer_of_the_same_data_seed_is_found(tmp_path: Path, data_seed: int) -> None:
    for seed in (0, 1):
        run = tmp_path / "balls" / "4to4" / "derenderer" / "full" / "ground_truth" / f"seed0+data_seed-{seed}"
        (run / "checkpoints").mkdir(parents=True)
        (run / "metrics.json").touch()
        trained_on = [[balls(seed).id]]
        saved(run / "checkpoints" / "best.ckpt", SMALL_DERENDERER, {}, data_seed=seed, trained_on=trained_on)
    assert f"data_seed-{data_seed}" in str(find_derenderer(tmp_path, [balls(data_seed)], {4}, "4to4").source)


def test_a_missing_checkpoint_is_named(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no\.ckpt is not a file"):
        TrainedDerenderer(tmp_path / "no.ckpt")


def test_a_checkpoint_holds_what_a_derenderer_was_trained_on(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL_DERENDERER, weights_of(SMALL_DERENDERER), num_objects=[3, 4])
    derenderer = TrainedDerenderer(path)
    assert (derenderer.scenario, derenderer.num_objects) == ("balls", {3, 4})
    position, logit = derenderer(IMAGE)
    assert position.shape == (*logit.shape, 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"split": {"name": "4to4", "test": {"num_objects": "many"}}}, "num_objects"),
        ({"num_objects": ["many"]}, "num_objects"),
        ({"model": {"_target_": DERENDERER, "slots": 4}}, "model.slots"),
        ({"trained_on": []}, "trained_on"),
        ({"render": RENDER | {"backend": "paper"}}, "Invalid value 'paper'"),
        ({"render": RENDER | {"resolution": 10**9}}, "render.resolution=1000000000 must be between"),
    ],
)
def test_an_origin_without_what_a_derenderer_needs_is_named(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL_DERENDERER, {}, **changes)
    with pytest.raises(CophyError, match=MISFIT + message):
        TrainedDerenderer(path)


def test_weights_of_another_derenderer_are_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", SMALL_DERENDERER | {"width": 4}, weights_of(SMALL_DERENDERER))
    with pytest.raises(CophyError, match=MISFIT + r"does not fit cophy\.models\.derenderer\.Derenderer as it is now"):
        TrainedDerenderer(path)(IMAGE)


def make_derenderer(folder: Path, **values: float) -> TrainedDerenderer:
    """Return one that finds every object, with weights of these names filled with a value."""
    weights = weights_of(SMALL_DERENDERER)
    weights["heads.geometry.4.bias"] += torch.tensor([0.0, 0.0, 0.0, 100.0])  # presence
    values = {"deviation": 0.0, **values}
    weights |= {name: torch.full_like(weights[name], value) for name, value in values.items()}
    released = {"source": {"name": "cophy"}, "num_objects": [len(SMALL_DERENDERER["slots"])]}  # of unknown colours
    return TrainedDerenderer(saved(folder / "derenderer.ckpt", SMALL_DERENDERER, weights, **released))


def make_predictor(folder: Path, **origin: Any) -> TrainedPredictor:
    return predictor_of(saved(folder / "predictor.ckpt", SMALL, weights_of(SMALL), **origin))


def test_the_test_error_is_that_of_the_run_or_of_the_index(tmp_path: Path) -> None:
    (folder := tmp_path / "checkpoints").mkdir()
    derenderer = make_derenderer(folder)
    assert derenderer.test_error() is None
    (tmp_path / "metrics.json").write_text('{"metrics": {"euclidean_error": 0.083, "presence_accuracy": 0.9991}}')
    assert derenderer.test_error() == "0.08 m, presence correct in 99.9 % of slots"
    index = folder / "index.csv"
    index.write_text(f"sha256,euclidean_error,presence_accuracy\n{derenderer.name},0.2,1\n")
    assert derenderer.test_error() == "0.20 m, presence correct in 100.0 % of slots"
    for text in ("sha256,test_mse\n", f"sha256,euclidean_error\n{derenderer.name},\n"):
        index.write_text(text)
        assert derenderer.test_error() is None


def predict_with(derenderer: TrainedDerenderer, predictor: TrainedPredictor) -> Counterfactual:
    images = np.zeros((predictor.scenario.clock.num_frames, 16, 16, 3), np.uint8)
    return predict(images, images[0], derenderer, predictor)


def test_predictions_that_are_not_finite_are_refused_with_the_checkpoint(tmp_path: Path) -> None:
    predictor = make_predictor(tmp_path)
    assert np.isfinite(predict_with(make_derenderer(tmp_path), predictor).positions).all()
    with pytest.raises(CophyError, match=r"derenderer=.*derenderer\.ckpt predicts non-finite values"):
        predict_with(make_derenderer(tmp_path, mean=float("nan")), predictor)
    with torch.no_grad():
        next(predictor.network.parameters()).fill_(float("nan"))
    with pytest.raises(CophyError, match=r"predictor=.*predictor\.ckpt predicts non-finite values"):
        predict_with(make_derenderer(tmp_path), predictor)


def test_an_attribute_error_in_forward_keeps_its_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor = make_predictor(tmp_path)
    monkeypatch.setattr(predictor.network, "forward", lambda inputs: inputs.nonsense)
    with pytest.raises(AttributeError, match="nonsense"):
        predict_with(make_derenderer(tmp_path), predictor)


def test_both_checkpoints_need_the_same_colours(tmp_path: Path) -> None:
    scenario = plain_settings()["scenario"]
    check_pair(make_derenderer(tmp_path), make_predictor(tmp_path))
    fewer = scenario | {"colors": dict(list(scenario["colors"].items())[:4]), "num_objects": [2, 3, 4]}
    with pytest.raises(CophyError, match=r"derenderer\.ckpt was trained on .*, predictor=.*predictor\.ckpt on "):
        check_pair(make_derenderer(tmp_path), make_predictor(tmp_path, scenario=fewer))
