"""From pictures to positions, to a predictor that sees them, and to a prediction from files."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cophy.dataset.states import States
from cophy.drawing.files import read_frames
from cophy.training.trained import TrainedDerenderer
from tests.commands import run, train
from tests.conftest import tiny_spec

LOOK_EXPERIMENT = 4  # experiment= of conf/look.yaml


def test_from_pictures_to_a_counterfactual(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """De-renderer, estimates, a predictor that sees them, and a prediction from files."""
    small = ("scenario=collision", f"source.outputs={tmp_path}")

    def directory(model: str, positions: str) -> Path:
        (path,) = tmp_path.glob(f"collision/all/{model}/full/{positions}/seed0+size-tiny*")
        return path

    sizes = ("model.resolution=16", "model.width=2", "model.readout=linear", "num_images=40")
    train("model=derenderer", *small, "render.resolution=16", "logger=tensorboard", *sizes, data=tiny_data)
    row = directory("derenderer", "ground_truth")
    metrics = json.loads((row / "metrics.json").read_text())["metrics"]
    assert {"mse", "euclidean_error", "x_error", "presence_accuracy", "mean_position_error"} <= set(metrics)
    curves = EventAccumulator(str(tmp_path / "tensorboard" / f"collision_all_derenderer_{row.name}"))
    curves.Reload()
    assert {"val/centres", "val/clip"} <= set(curves.Tags()["images"])

    derender = ("derender", "scenario=collision", "size=tiny", f"data_dir={tiny_data}", f"outputs={tmp_path}")
    assert "all 48 experiments in 2 shards" in run(*derender)
    (estimates,) = tiny_data.rglob(f"derendered-{TrainedDerenderer(row / 'checkpoints' / 'best.ckpt').name}")
    whole = {path.name: path.read_bytes() for path in estimates.iterdir() if path.suffix in (".h5", ".json")}
    shutil.rmtree(estimates)
    assert "part 1 of 2 is complete, others are not" in run(*derender, "part=1", "parts=2")
    run(*derender, "part=0", "parts=2")
    assert len(whole) == 3
    assert {name: (estimates / name).read_bytes() for name in whole} == whole

    train(*small, "positions=derendered", data=tiny_data)
    predictor = directory("cophynet", "derendered")
    assert json.loads((predictor / "metrics.json").read_text())["positions"] == "derendered"

    look = tmp_path / "look"
    run(
        "look",
        "scenario=collision",
        "size=tiny",
        f"data_dir={tiny_data}",
        "num_shown=1",
        "render.resolution=112",
        f"directory={look}",
    )
    assert {path.name for path in look.iterdir()} == {
        "sheet.png",
        "twins.png",
        "strip.png",
        "modalities.png",
        "clip.gif",
        "AB",
        "CD",
        "background.png",
    }
    checkpoints = {
        "derenderer": row / "checkpoints" / "best.ckpt",
        "predictor": predictor / "checkpoints" / "best.ckpt",
    }
    keys = [f"{key}={path}" for key, path in checkpoints.items()]
    files = [f"observed={look / 'AB'}", f"initial={look / 'CD' / '00.png'}", f"truth={look / 'CD'}"]
    predicted = [*files, *keys, f"background={look / 'background.png'}", f"directory={tmp_path / 'predicted'}"]
    untrained = run("predict", *predicted, code=1)
    assert "the de-renderer" in untrained.splitlines()[-1]
    assert not (tmp_path / "predicted").exists()
    swapped = run("predict", *files, f"derenderer={checkpoints['predictor']}", keys[1], code=1)
    assert "not of a de-renderer" in swapped
    short = run("predict", files[1], f"observed={look / 'CD' / '00.png'}", *keys, code=1)
    assert "AB has 1 frames; the predictor needs 15" in short

    spec = tiny_spec("collision")
    arrays = States(spec, tiny_data).load()
    states = arrays["states"][LOOK_EXPERIMENT, :, :: spec.scenario.clock.states_per_frame, :, :3]
    logit = np.where(arrays["presence"][LOOK_EXPERIMENT], 9.0, -9.0).astype(np.float32)

    initial = read_frames(look / "CD")[0]

    def exact(derenderer: TrainedDerenderer, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sequence = int(len(rgb) == 1 or (rgb[0] == initial).all())  # C or CD
        return states[sequence, : len(rgb)], np.broadcast_to(logit[sequence], (len(rgb), logit.shape[1]))

    monkeypatch.setattr(TrainedDerenderer, "__call__", exact)
    text = run("predict", *predicted)
    assert "presence 100.0 % in AB, reprojection error 0.0" in text
    table = np.loadtxt(tmp_path / "predicted" / "positions.csv", delimiter=",", skiprows=1, usecols=(0, 2, 3, 4))
    off = table[:, 1:].reshape(len(states[1]), -1, 3) - states[1][:, arrays["presence"][LOOK_EXPERIMENT, 1]]
    mse = np.square(off[1:, :, : spec.scenario.task.metric_dims]).mean()
    (printed,) = re.findall(r"MSE of the prediction (.*) m²", text)
    assert float(printed) == pytest.approx(mse, rel=1e-3, abs=1e-4)
    assert "test error" not in text  # the predictor was trained on estimates
    assert (tmp_path / "predicted" / "prediction.gif").read_bytes()[:4] == b"GIF8"
    assert (tmp_path / "predicted" / "positions.csv").read_text().startswith("frame,object,x_m,y_m,z_m\n0,")
    assert (tmp_path / "predicted" / "objects.csv").read_text().startswith("sequence,object,presence_probability,")
