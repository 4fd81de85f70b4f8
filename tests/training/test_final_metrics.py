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


def test_metrics_can_be_computed_from_the_file_of_predictions_by_numpy_alone(
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
    expected = {name: ((each & observed).sum(axis=1) / observed.sum(axis=1)).mean() for name, each in correct.items()}
    expected |= measures_of_towers(**stored)
    assert {name: metrics[name] for name in expected} == pytest.approx(expected)


def measures_of_towers(
    position: np.ndarray,
    target: np.ndarray,
    presence: np.ndarray,
    stable: np.ndarray,
    stable_logit: np.ndarray,
    **_: np.ndarray,
) -> dict[str, float]:
    """Return the means of docs/benchmark/metrics.md; twins are neighbours."""
    position, target = (presence[:, None, :, None] * each.astype(np.float64) for each in (position, target))
    swapped = np.arange(len(target)) ^ 1  # the twin of each experiment
    difference, predicted = target - target[swapped], position - position[swapped]
    nearer = np.sum((position - target) ** 2, axis=(1, 2, 3)) < np.sum(
        (position - target[swapped]) ** 2, axis=(1, 2, 3)
    )
    present = presence[:, None] / presence.sum(axis=1)[:, None, None] / len(presence)
    steps, says_stable = target.shape[1], stable_logit > 0
    return {
        "mse": float((present[..., None] * (position - target) ** 2).sum() / steps / 3),
        "final_position_error": float((present[:, 0] * np.linalg.norm(position - target, axis=-1)[:, -1]).sum()),
        "twin_difference_explained": float(1 - np.sum((predicted - difference) ** 2) / np.sum(difference**2)),
        "right_twin_chosen": float(nearer.mean()),
        "stability_accuracy": float((present * (says_stable == stable)).sum() / steps),
        "stability_base_rate": float((present * stable).sum() / steps),
        "sequence_stability_accuracy": float((present[:, 0] * (says_stable.all(axis=1) == stable.all(axis=1))).sum()),
    }


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
