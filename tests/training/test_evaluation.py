"""Means, intervals and the probe."""

import numpy as np
import pytest
import torch

from cophy.errors import CophyError
from cophy.intervals import interval, mean
from cophy.models.copying import CopyC
from cophy.training.evaluation import evaluate
from cophy.training.prediction import PredictionModule
from cophy.training.probe import probe
from cophy.training.run import build_network
from cophy.types import Batch, Prediction
from tests.conftest import settings


def test_experiments_that_do_not_count_are_left_out() -> None:
    assert mean(np.array([1.0, np.nan, 3.0])) == 2.0


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    """Also where twins err alike: it is over pairs."""
    rng = np.random.default_rng(0)
    for alike in (1, 2):
        samples = (np.repeat(rng.exponential(1.0, 200 // alike), alike) for _ in range(300))
        covered = [low <= 1.0 <= high for low, high in (interval(sample, np.arange(200) // 2) for sample in samples)]
        assert 0.90 <= np.mean(covered) <= 0.97


def test_the_interval_leaves_out_what_does_not_count() -> None:
    values = np.random.default_rng(0).normal(size=400)
    holes = np.concatenate([values, np.full(40, np.nan)])
    pairs = np.arange(440) // 2
    assert interval(holes, pairs) == pytest.approx(interval(values, pairs[:400]))


def test_items_of_a_pair_are_resampled_together_however_many_there_are() -> None:
    pairs = np.array([0, 0, 0, 7, 7])
    assert interval(np.array([1.0, 1.0, 1.0, 2.0, 2.0]), pairs) == (1.0, 2.0)
    assert interval(np.array([1.0, 2.0, 3.0]), np.zeros(3, dtype=int)) == (2.0, 2.0)


def test_a_prediction_that_is_not_finite_is_an_error(tower_batch: Batch, scenario_of) -> None:
    scenario = scenario_of("blocktower")
    position = tower_batch.target.clone()
    position[3, 5] = torch.nan
    with pytest.raises(CophyError, match="not finite"):
        evaluate(Prediction(position), tower_batch, scenario)
    with pytest.raises(CophyError, match="not finite"):
        evaluate(
            Prediction(tower_batch.target, torch.full_like(tower_batch.target[..., 0], torch.nan)),
            tower_batch,
            scenario,
        )
    absent = torch.where(tower_batch.presence[:, None, :, None], tower_batch.target, torch.nan)
    assert evaluate(Prediction(absent), tower_batch, scenario)["mse"].max() == 0  # what is absent does not matter


WRONG = {
    "a tensor": lambda batch: batch.observed,
    "a frame too many": lambda batch: Prediction(batch.observed),
    "one step for all": lambda batch: Prediction(batch.observed[:, :1]),
    "boolean stability": lambda batch: Prediction(batch.target, batch.stable),
    "an estimate without slots": lambda batch: Prediction(batch.target, None, batch.initial[:, 0]),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_prediction_is_refused_in_one_line(wrong: str, tower_batch: Batch) -> None:
    class Wrong(torch.nn.Module):
        def forward(self, batch: Batch) -> Prediction:
            return WRONG[wrong](batch)

    chosen = settings("train")
    module = PredictionModule(Wrong(), chosen.training, chosen.scenario, np.eye(2)[None], config={})
    with pytest.raises(CophyError, match="Wrong returns"):
        module(tower_batch)


def labelled(count: int, seed: int) -> tuple[torch.Tensor, Batch]:
    """U that gives the mass away and says nothing about friction; the second of two slots is empty every other time."""
    generator = torch.Generator().manual_seed(seed)
    classes = torch.randint(0, 2, (count, 2, 2), generator=generator)
    presence = torch.ones(count, 2, dtype=torch.bool)
    presence[::2, 1] = False
    noise = torch.randn(count, 2, 4, generator=generator)
    estimate = noise + 20 * classes[..., :1] * torch.tensor([1.0, 0, 0, 0])
    empty = torch.zeros(0)
    fields = dict.fromkeys(Batch._fields, empty)
    batch = Batch(**{**fields, "observed_presence": presence, "presence": presence, "confounder_class": classes})
    return torch.where(presence[..., None], estimate, 1e6), batch


def test_a_model_knows_nothing_of_d(tower_batch: Batch, monkeypatch: pytest.MonkeyPatch) -> None:
    class Peeking(torch.nn.Module):
        def forward(self, batch: Batch) -> Prediction:
            assert not torch.cat([batch.stable.flatten(), batch.target_presence.flatten()]).any()
            assert batch.target_initial.isnan().all()
            return Prediction(batch.target)

    chosen = settings("train", "scenario=blocktower")
    module = PredictionModule(Peeking(), chosen.training, chosen.scenario, np.eye(2)[None], config={})
    assert module(tower_batch).position.isnan().all()
    monkeypatch.setattr(module, "log_dict", lambda *_, **__: None)  # there is no trainer
    with pytest.raises(CophyError, match="Peeking predicts what is not finite"):
        module.validation_step(tower_batch)


def test_a_promised_estimate_is_asked_for(tower_batch: Batch) -> None:
    class Promising(CopyC):
        estimate_dim = 8

    chosen = settings("train", "scenario=blocktower", "ablation=supervised_confounders")
    module = PredictionModule(Promising(), chosen.training, chosen.scenario, np.eye(2)[None], config={})
    with pytest.raises(CophyError, match="Promising has an estimate_dim, but returns no confounder_estimate"):
        module(tower_batch)


def test_the_probe_finds_what_is_there_and_nothing_else() -> None:
    values = {name: value.mean() for name, value in probe(labelled(2000, 0), labelled(2000, 1)).items()}
    assert values["probe_mass_accuracy"] == 1.0
    assert values["probe_friction_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_chance"] == pytest.approx(0.25, abs=0.03)


def test_the_probe_of_a_constant_is_right() -> None:
    (estimate, batch), test = labelled(200, 0), labelled(200, 1)

    def constant(batch: Batch) -> Batch:
        return batch._replace(confounder_class=batch.confounder_class * torch.tensor([1, 0]))

    values = probe((estimate, constant(batch)), (test[0], constant(test[1])))
    assert values["probe_friction_accuracy"].mean() == 1.0
    assert values["probe_mass_accuracy"].mean() == 1.0


def test_a_model_without_a_class_is_refused() -> None:
    with pytest.raises(CophyError, match="_target_ is missing"):
        build_network({"hidden_dim": 32})
