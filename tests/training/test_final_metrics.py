"""The results of a test, and predictions of single experiments."""

import json
from contextlib import nullcontext
from pathlib import Path

import lightning as L
import numpy as np
import pytest
from torch import nn

from cophy.config import settings
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.models.baselines import CopyB
from cophy.training.run import Run, read_predictions
from cophy.types import Inputs, Prediction
from tests.conftest import quick_first, tiny_spec
from tests.models.networks import build
from tests.training.test_predictor import QUIET, Returning, module_of


@pytest.fixture(scope="module")
def towers(tiny_data: Path) -> CounterfactualDataModule:
    chosen = settings("train", "scenario=blocktower", "split=3to3")
    states = States(tiny_spec("blocktower"), tiny_data)
    data = CounterfactualDataModule(
        chosen.split, train_set=states, test_set=states, batch_size=chosen.training.batch_size, workers=1
    )
    data.setup()
    return data


def test_probes_are_those_of_the_predictions_with_twins_next_to_each_other(
    towers: CounterfactualDataModule, tmp_path: Path
) -> None:
    module = module_of(build("cophynet"))
    L.Trainer(**QUIET).test(module, towers, verbose=False)
    Run("blocktower", "3to3", "cophynet", "full", "ground_truth", 0, "tiny", "", tmp_path).write_results(
        module.results(towers), {}
    )
    metrics, stored = json.loads((tmp_path / "metrics.json").read_text())["metrics"], read_predictions(tmp_path)
    assert sorted(stored["experiment"]) == towers.test_experiments.tolist()
    assert (np.diff(stored["pair"]) >= 0).all()
    classes, observed = stored["confounder_class"], stored["confounder_class"][..., 0] >= 0
    assert classes.dtype == np.int16
    correct = {
        "probe_accuracy": (stored["probe_mass_and_friction"] == classes).all(axis=-1),
        "probe_mass_accuracy": stored["probe_mass"] == classes[..., 0],
        "probe_friction_accuracy": stored["probe_friction"] == classes[..., 1],
        "probe_chance": (stored["probe_most_frequent"] == classes).all(axis=-1),
    }
    shares = {name: ((each & observed).sum(axis=1) / observed.sum(axis=1)).mean() for name, each in correct.items()}
    assert {name: value for name, value in metrics.items() if "probe" in name} == pytest.approx(shares)


class BatchMean(nn.Module):
    """Predicts the mean outcome of AB over the experiments of the batch."""

    def forward(self, inputs: Inputs) -> Prediction:
        return Prediction(inputs.observed[:, 1:].mean(dim=0, keepdim=True).expand(len(inputs), -1, -1, -1))


def test_a_prediction_that_depends_on_the_batch_is_refused(towers: CounterfactualDataModule) -> None:
    message = "BatchMean: its prediction of an experiment depends on the other experiments of the batch"
    with pytest.raises(CophyError, match=message):
        module_of(BatchMean()).check_batches(towers.test.batch.inputs)


@pytest.mark.parametrize(("shift", "is_refused"), [(1e-5, False), (1e-2, True)])
def test_a_difference_below_a_millimetre_is_rounding(
    shift: float, is_refused: bool, towers: CounterfactualDataModule
) -> None:
    module = module_of(Returning(lambda inputs: Prediction(CopyB()(inputs).position + shift * len(inputs))))
    with pytest.raises(CophyError, match=r"by 0\.\d+ m") if is_refused else nullcontext():
        module.check_batches(towers.test.batch.inputs)


@pytest.mark.parametrize("choice", quick_first(["cophynet", "copy_b", "copy_c", "mlp", "npe", "alongside"], 2))
def test_models_predict_one_experiment_at_a_time(choice: str, towers: CounterfactualDataModule) -> None:
    module_of(build(choice).train()).check_batches(towers.test.batch.inputs)
