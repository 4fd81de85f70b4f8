"""The module of predictors: what a network is given, what it has to return, and what a training step does with it."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import lightning as L
import pytest
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from cophy.dataset.datamodules import CounterfactualDataset
from cophy.dataset.frames import FrameBatch
from cophy.errors import CophyError
from cophy.models.baselines import CopyC
from cophy.models.derenderer import Derenderer
from cophy.training.derenderer import DerenderingModule
from cophy.training.metrics import VALIDATED
from cophy.training.predictor import PredictionModule
from cophy.types import Batch, Inputs, Prediction
from tests.conftest import cached_settings
from tests.models.networks import build
from tests.training.scored import scored


def module_of(
    network: nn.Module, *overrides: str, missed: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> PredictionModule:
    chosen = cached_settings("train", "scenario=blocktower", *overrides)
    module = PredictionModule(network, chosen.training, chosen.scenario)
    module.missed_position.copy_(torch.tensor(missed))
    return module


QUIET: dict[str, Any] = {
    "accelerator": "cpu",
    "logger": False,
    "enable_checkpointing": False,
    "enable_progress_bar": False,
    "enable_model_summary": False,
}


class Returning(nn.Module):
    """Returns what a function makes of the inputs."""

    def __init__(self, function: Callable[[Inputs], Any]) -> None:
        super().__init__()
        self.function = function

    def forward(self, inputs: Inputs) -> Any:
        return self.function(inputs)


WRONG = {
    "a tensor": lambda inputs: inputs.observed,
    "a frame too many": lambda inputs: Prediction(inputs.observed),
    "one step for all": lambda inputs: Prediction(inputs.observed[:, :1]),
    "another number of slots": lambda inputs: Prediction(inputs.observed[:, 1:, :2]),
    "a variance, as oracles": lambda inputs: Prediction(inputs.observed[:, 1:], draw_variance=inputs.observed[:, 1:]),
    "an estimate of another width": lambda inputs: Prediction(inputs.observed[:, 1:], None, inputs.initial),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_prediction_is_refused_in_one_line(wrong: str, tower_batch: Batch) -> None:
    network = Returning(WRONG[wrong])
    network.estimate_dim = 8 if "width" in wrong else 0
    with pytest.raises(CophyError, match="Returning returns"):
        module_of(network)(tower_batch)


def test_a_network_is_given_inputs_and_nothing_of_d(tower_batch: Batch) -> None:
    seen = []
    module_of(Returning(lambda inputs: seen.append(inputs) or CopyC()(inputs)))(tower_batch)
    assert seen == [tower_batch.inputs]
    names = {field.name for field in fields(Inputs)}
    always = {"observed", "observed_presence", "observed_stable", "initial", "presence"}
    assert names == always | {"confounders", "object_type", "pose"}


def test_a_prediction_that_is_not_finite_stops_the_training(
    tower_batch: Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = module_of(Returning(lambda inputs: Prediction(inputs.observed[:, 1:] * torch.nan)))
    monkeypatch.setattr(module, "log_dict", lambda *_, **__: None)  # there is no trainer
    with pytest.raises(CophyError, match="Returning predicts non-finite values"):
        module.validation_step(tower_batch)


def test_a_derenderer_that_is_not_finite_stops_its_training(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Derenderer(slots=("red",), resolution=8, width=1, readout="linear")
    torch.nn.init.constant_(next(network.parameters()), torch.nan)
    module = DerenderingModule(network, cached_settings("train").training)
    monkeypatch.setattr(module, "log_dict", lambda *_, **__: None)  # there is no trainer
    batch = FrameBatch(
        torch.zeros(1, 3, 8, 8, dtype=torch.uint8), torch.zeros(1, 1, 3), torch.ones(1, 1, dtype=torch.bool)
    )
    with pytest.raises(CophyError, match="Derenderer predicts non-finite values"):
        module.validation_step(batch)


def test_an_output_that_does_not_depend_on_parameters_stops_the_training(tower_batch: Batch) -> None:
    class Detached(CopyC):
        def __init__(self) -> None:
            super().__init__()
            self.linear = nn.Linear(3, 3)

        def forward(self, inputs: Inputs) -> Prediction:
            copied = super().forward(inputs)
            return replace(copied, position=self.linear(copied.position).detach())

    trainer = L.Trainer(max_epochs=1, num_sanity_val_steps=0, **QUIET)
    batches = DataLoader([tower_batch], batch_size=None)
    with pytest.raises(CophyError, match="Detached: the loss does not depend on its parameters"):
        trainer.fit(module_of(Detached()), batches, batches)


def test_a_promised_estimate_is_asked_for(tower_batch: Batch) -> None:
    class Promising(CopyC):
        estimate_dim = 8

    with pytest.raises(CophyError, match="Promising has an estimate_dim, but returns no confounder_estimate"):
        module_of(Promising(), "ablation=supervised_confounders")(tower_batch)


def test_a_missed_object_counts_as_predicted_at_the_mean_of_training(tower_batch: Batch) -> None:
    module = module_of(CopyC(), missed=(1.0, 2.0, 3.0))
    presence = tower_batch.inputs.presence.clone()
    presence[:, 2] = False
    position = module(replace(tower_batch, inputs=replace(tower_batch.inputs, presence=presence))).position
    missed = tower_batch.targets.presence[:, 2]
    assert missed.any()
    assert (position[missed][:, :, 2] == torch.tensor([1.0, 2.0, 3.0])).all()
    torch.testing.assert_close(position[:, :, 1], tower_batch.inputs.initial[:, None, 1].expand(-1, 29, -1))


class Recording(nn.Module):
    """Copies C with a learnt offset, and keeps the positions of AB that it was given in training and in validation."""

    def __init__(self) -> None:
        super().__init__()
        self.offset = nn.Parameter(torch.zeros(3))
        self.seen: dict[bool, Tensor] = {}

    def forward(self, inputs: Inputs) -> Prediction:
        self.seen[self.training] = inputs.observed
        return Prediction(CopyC()(inputs).position + self.offset)


def test_noise_is_of_training_alone(tower_batch: Batch) -> None:
    network = Recording()
    module = module_of(network, "training.position_noise=0.1", "training.augmentation=none")
    trainer = L.Trainer(max_epochs=1, num_sanity_val_steps=0, **QUIET)
    batches = DataLoader([tower_batch], batch_size=None)
    trainer.fit(module, batches, batches)
    assert torch.equal(network.seen[False], tower_batch.inputs.observed)
    assert 0.01 < (network.seen[True] - tower_batch.inputs.observed).std() < 0.1


@pytest.mark.parametrize("has_twins", [True, False])
def test_validation_scores_all_experiments_at_once(has_twins: bool, tower_batch: Batch) -> None:
    targets = tower_batch.targets
    targets = targets if has_twins else replace(targets, pair=torch.arange(len(targets)))
    module, batch = module_of(build("cophynet")), replace(tower_batch, targets=targets)
    (values,) = L.Trainer(**QUIET).validate(module, CounterfactualDataset(batch).in_order(16), verbose=False)
    with torch.no_grad():
        scores = scored(module.eval()(batch), targets, module.scenario)
    expected = {name: mean for name, mean in scores.means().items() if name in VALIDATED}
    cell, cells = targets.cell.numpy(), enumerate(module.scenario.cells())
    expected |= {f"mse_{name}": scores.mse[cell == i].mean() for i, name in cells if i in cell}
    assert expected.keys() >= {*VALIDATED} - (
        set() if has_twins else {"twin_difference_explained", "right_twin_chosen"}
    )
    measured = {name.removeprefix("val/"): value for name, value in values.items() if not name.endswith("loss")}
    assert measured == pytest.approx(expected, rel=1e-5)
    assert module.standing.sum() == len(batch)
