"""A run on two devices is the run on one: every experiment counts once, and the numbers are the same."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.commands import ON_TWO, train


def results(outputs: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """metrics.json and predictions.npz of the only run."""
    (metrics,) = outputs.rglob("metrics.json")
    with np.load(metrics.with_name("predictions.npz")) as file:
        return json.loads(metrics.read_text()), dict(file)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["", "size.num_experiments.collision.2=50"], ids=["even", "uneven"])
def test_two_processes_leave_what_one_does(tiny_data: Path, tmp_path: Path, size: str) -> None:
    # SOAP would amplify differences of rounding
    keys = ("scenario=collision", "model=in", "optimizer=adam", "trainer.max_epochs=2", *([size] if size else []))
    printed = train(*keys, *ON_TWO, f"source.outputs={tmp_path / 'two'}", data=tiny_data, apart=True)
    assert "sync_dist" not in printed
    two, predicted = results(tmp_path / "two")
    train(*keys, f"source.outputs={tmp_path / 'one'}", data=tiny_data)
    one, _ = results(tmp_path / "one")
    assert two["num_test"] == len(predicted["pair"]) == one["num_test"]
    assert two["validation"] == pytest.approx(one["validation"], abs=1e-4)  # two trainings, rounded otherwise
    again = train(*keys, f"source.outputs={tmp_path / 'two'}", data=tiny_data)
    assert "already trained" in again  # the same run; its checkpoint is tested by one process
    tested, predicted_again = results(tmp_path / "two")
    assert tested["metrics"] == pytest.approx(two["metrics"], abs=1e-6)
    assert tested["intervals"].keys() == two["intervals"].keys()
    for name, values in predicted_again.items():
        np.testing.assert_allclose(predicted[name], values, atol=1e-6)


def test_a_sweep_of_runs_on_two_devices_is_refused(tmp_path: Path) -> None:
    sweep = ("-m", "scenario=collision", "model=in", "seed=0,1", f"hydra.sweep.dir={tmp_path / 'runs'}")
    assert "one command for each run" in train(*sweep, *ON_TWO, data=tmp_path / "data", code=1)
    assert not (tmp_path / "data").exists()  # nothing was generated before


def test_a_derenderer_is_refused(tmp_path: Path) -> None:
    """Each device would normalise by its own share of a batch."""
    small = ("model.resolution=16", "model.width=2", "model.readout=linear", "num_images=20", "render.resolution=16")
    keys = ("model=derenderer", "scenario=collision", *small, f"hydra.run.dir={tmp_path / 'run'}")
    assert "train it on one device" in train(*keys, *ON_TWO, data=tmp_path / "data", code=1)
    assert not (tmp_path / "data").exists()
