"""The example scripts for other frameworks are short, and lead to a scored file."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import cophy
from cophy.dataset.states import States
from cophy.submission import load_truth, read_predictions_file
from tests.conftest import ROOT, tiny_spec

ENSEMBLE = ROOT / "docs" / "examples" / "ensemble.py"
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
MAX_LINES = 60


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_LINES


@pytest.mark.parametrize("path", [path for path in EXAMPLES if path != ENSEMBLE], ids=lambda path: path.stem)
def test_an_example_leads_to_scores(
    path: Path, tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if path.stem == "jax_model":
        pytest.importorskip("jax")
    (tmp_path / "data").symlink_to(tiny_data)
    monkeypatch.chdir(tmp_path)
    dataset = States(tiny_spec("collision"), tiny_data).directory
    given = ["collision", "tiny"] if path.stem == "torch_loop" else [str(dataset)]
    monkeypatch.setattr(sys, "argv", [str(path), *given, "mine.npz"])
    runpy.run_path(str(path), run_name="__main__")
    truth = load_truth("collision", size="tiny", data_dir=tiny_data)
    scores = cophy.score(read_predictions_file(tmp_path / "mine.npz", truth), truth)
    assert np.isfinite(scores.mse).all()
    if path.stem == "numpy_rule":  # the only one that needs no training
        assert scores.means()["mse"] < cophy.score(read_copy_c(truth), truth).means()["mse"]


def test_an_ensemble_scores_its_mean_and_its_spread(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = load_truth("collision", size="tiny", data_dir=tiny_data)
    runs = [tmp_path / "near", tmp_path / "far"]
    for run, error in zip(runs, (1, 3), strict=True):
        run.mkdir()
        np.savez(run / "predictions.npz", experiment=truth.experiment, position=truth.position + error)
    monkeypatch.setattr(sys, "argv", [str(ENSEMBLE), str(tmp_path / "mine.npz"), *map(str, runs)])
    runpy.run_path(str(ENSEMBLE), run_name="__main__")
    scores = cophy.score(read_predictions_file(tmp_path / "mine.npz", truth), truth)
    assert scores.means()["mse"] == pytest.approx(2**2)  # of the mean
    assert scores.means()["energy_score"] == pytest.approx((1 + 3) / 2 - (3 - 1) / 2)


def read_copy_c(truth: cophy.scoring.Truth) -> cophy.scoring.Predictions:
    position = np.repeat(truth.initial[:, None], truth.position.shape[1], axis=1)
    return cophy.scoring.Predictions(truth.experiment, position)
