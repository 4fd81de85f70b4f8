"""The final metrics of a test, recomputed from the files of a run by plain NumPy, and predictions of single experiments."""

import json
from contextlib import nullcontext
from pathlib import Path

import lightning as L
import numpy as np
import pytest
import torch
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


def over_objects(values: np.ndarray, present: np.ndarray) -> float:
    return float((np.where(present, values, 0).sum(axis=1) / present.sum(axis=1)).mean())


def squared(difference: np.ndarray) -> np.ndarray:
    return np.square(difference).sum(axis=(1, 2, 3))


def recomputed(directory: Path, positions: np.ndarray, presence: np.ndarray) -> tuple[dict[str, float], list[float]]:
    """Return the metrics of metrics.json and the MSE of copies C and B, as docs/benchmark/metrics.md defines them.

    positions: (all experiments, 2, T, K, 3) of AB and CD, and presence (all experiments, 2, K), from the shards.
    """
    z = np.load(directory / "predictions.npz", allow_pickle=False)
    true, predicted, present = z["target"].astype(float), z["position"].astype(float), z["presence"]
    stable, guess = z["stable"], z["stable_logit"] > 0
    # the last positions in the image of the camera, conf/scenario/blocktower.yaml
    forward = np.array([0, 11, 1.3 - 5]) / np.hypot(11, 1.3 - 5)
    axes = np.stack([[1, 0, 0], np.cross([1, 0, 0], forward), forward])
    x, y, depth = np.moveaxis((np.stack([true, predicted])[:, :, -1] - [0, -11, 5]) @ axes.T, -1, 0)
    pixels = np.hypot(np.subtract(*x / depth), np.subtract(*y / depth)) * 224 / np.tan(np.radians(45 / 2))
    rank = np.where(present, z["initial"][..., 2], np.inf).argsort(axis=1).argsort(axis=1)
    heights = [pixels[present & (rank == level)].mean() for level in range(present.sum(axis=1).max())]
    pairs = [np.flatnonzero(z["pair"] == pair) for pair in np.unique(z["pair"])]
    a, b = np.transpose([pair for pair in pairs if len(pair) == 2])
    difference, predicted_difference = true[a] - true[b], predicted[a] - predicted[b]
    nearer = [squared(predicted[i] - true[j]) - squared(predicted[i] - true[i]) for i, j in ((a, b), (b, a))]
    classes, both = z["confounder_class"], z["probe_mass_and_friction"]
    metrics = {
        "mse": over_objects(np.square(predicted - true).mean(axis=(1, 3)), present),
        "final_position_error": over_objects(np.linalg.norm(predicted - true, axis=-1)[:, -1], present),
        "pixel_error": over_objects(pixels, present),
        **{f"pixel_error_{level}": error for level, error in enumerate(heights, 1)},
        "pixel_error_by_height": np.mean(heights),
        "stability_accuracy": over_objects((guess == stable).mean(axis=1), present),
        "stability_base_rate": over_objects(stable.mean(axis=1), present),
        "sequence_stability_accuracy": over_objects(guess.all(axis=1) == stable.all(axis=1), present),
        "twin_difference_explained": 1 - squared(predicted_difference - difference).sum() / squared(difference).sum(),
        "right_twin_chosen": (1 + np.sign(nearer).mean()) / 2,
        "probe_accuracy": over_objects((both == classes).all(axis=-1), classes[..., 0] >= 0),
        "probe_mass_accuracy": over_objects(z["probe_mass"] == classes[..., 0], classes[..., 0] >= 0),
        "probe_friction_accuracy": over_objects(z["probe_friction"] == classes[..., 1], classes[..., 0] >= 0),
        "probe_chance": over_objects((z["probe_most_frequent"] == classes).all(axis=-1), classes[..., 0] >= 0),
    }
    seen = presence[z["experiment"], 0, None, :, None]
    copies = [z["initial"][:, None], np.where(seen, positions[z["experiment"], 0, 1:], z["initial"][:, None])]
    return metrics, [over_objects(np.square(copy - true).mean(axis=(1, 3)), present) for copy in copies]


def test_all_metrics_can_be_recomputed_from_the_files_of_a_run(
    towers: CounterfactualDataModule, tmp_path: Path
) -> None:
    module = module_of(build("cophynet"))
    with torch.no_grad():
        module.network.decoder.to_stable_logit.bias += 0.5  # some are predicted to be stable, some are not
    L.Trainer(**QUIET).test(module, towers, verbose=False)
    run = Run("blocktower", "3to3", "cophynet", "full", "ground_truth", 0, "tiny", "", tmp_path)
    run.write_results(module.results(towers), {})
    content = json.loads((tmp_path / "metrics.json").read_text())
    arrays = towers.test_set.load()
    positions = arrays["states"][:, :, :: towers.scenario.clock.states_per_frame, :, :3]
    metrics, copies = recomputed(tmp_path, positions, arrays["presence"])
    assert content["metrics"] == pytest.approx(metrics, rel=1e-9)
    assert list(content["copies"].values()) == pytest.approx(copies, rel=1e-9)
    stored = read_predictions(tmp_path)
    assert sorted(stored["experiment"]) == towers.test_experiments.tolist()
    assert (np.diff(stored["pair"]) >= 0).all()  # twins next to each other
    assert stored["confounder_class"].dtype == np.int16


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
