"""A finished training is reused."""

import json
from pathlib import Path

import pytest

from cophy.atomic_files import sha256
from cophy.report.runs import read_line
from tests.commands import train

RUN = "seed0+size-tiny+max_epochs-1"
HALVES = ("scenario=blocktower", "model=in")  # with splits that train on the same half


def result(root: Path, split: str) -> dict:
    return json.loads((root / f"blocktower/{split}/in/full/ground_truth/{RUN}/metrics.json").read_text())


def curves_in(root: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in root.rglob("events.out.tfevents.*")}


def test_splits_with_the_same_training_half_train_once(tiny_data: Path, tmp_path: Path) -> None:
    printed = train("-m", *HALVES, "split=3to3_seen,3to3_unseen", f"hydra.sweep.dir={tmp_path}", data=tiny_data)
    assert printed.count("already trained") == 1
    assert str(tmp_path / f"blocktower/3to3_seen/in/full/ground_truth/{RUN}/checkpoints") in printed
    assert result(tmp_path, "3to3_unseen")["metrics"]["mse"] != result(tmp_path, "3to3_seen")["metrics"]["mse"]
    assert result(tmp_path, "3to3_unseen")["training_seconds"] == result(tmp_path, "3to3_seen")["training_seconds"]
    assert result(tmp_path, "3to3_seen")["max_epochs"] == 2  # twice the epochs on half of the data
    named = (
        "scenario.task.splits=[3to3,3to4,3to3_seen,3to3_unseen,mine]"  # a split more does not train the others again
    )
    assert "already trained" in train(
        "-m", *HALVES, named, "split=3to3_unseen", f"hydra.sweep.dir={tmp_path}", data=tiny_data
    )
    check_given_checkpoint(tmp_path, tiny_data)


def check_given_checkpoint(outputs: Path, data: Path) -> None:
    """Check that a checkpoint given as predictor= is tested instead of training, with the same numbers."""
    kept = outputs / "kept.ckpt"
    kept.write_bytes((outputs / f"blocktower/3to3_seen/in/full/ground_truth/{RUN}/checkpoints/best.ckpt").read_bytes())
    trained = result(outputs, "3to3_unseen")
    elsewhere = (*HALVES, "split=3to3_unseen", f"predictor={kept}", f"source.outputs={outputs / 'elsewhere'}")
    train(*elsewhere, data=data)
    tested = result(outputs / "elsewhere", "3to3_unseen")
    alike = ("metrics", "intervals", "validation", "max_epochs", "dataset_ids", "variant")
    assert [tested[key] for key in alike] == [trained[key] for key in alike]
    assert (trained["predictor"], tested["predictor"]) == (None, sha256(kept)[:8])
    assert tested["training_seconds"] == 0
    line = read_line(next((outputs / "elsewhere").rglob("metrics.json")))
    assert line["is_trained"]  # not here, but it is no copy
    assert not list((outputs / "elsewhere").rglob("*.ckpt"))
    printed = train(*elsewhere, "seed=1", "trainer.max_epochs=2", "optimizer=adam", data=data, code=1)
    assert f"{kept} belongs to another training (" in printed
    assert all(difference in printed for difference in ("seed=0", "trainer.max_epochs=", "_target_"))
    assert "metrics.json belongs to a training with these settings" in train(
        *HALVES, "split=3to3_unseen", f"predictor={kept}", f"source.outputs={outputs}", data=data, code=1
    )
    assert result(outputs, "3to3_unseen") == trained
    train(*elsewhere, data=data)  # its own it may replace


@pytest.mark.slow
def test_curves_are_of_the_last_training_alone(tiny_data: Path, tmp_path: Path) -> None:
    place = (*HALVES, f"source.outputs={tmp_path}", "logger=[tensorboard]", "figures_every_n_epochs=9")
    train(*place, data=tiny_data, apart=True)
    first = curves_in(tmp_path)
    assert "already trained" in train(*place, data=tiny_data, apart=True)
    assert curves_in(tmp_path) == first
    train(*place, "reuse=false", data=tiny_data, apart=True)
    assert not curves_in(tmp_path).keys() & first.keys()


def test_another_training_is_not_reused(copied_run: Path, tiny_data: Path, tmp_path: Path) -> None:
    place = ("scenario=collision", f"hydra.run.dir={copied_run}")
    assert "already trained" in train(*place, data=tiny_data)
    assert "already trained" not in train(*place, "reuse=false", data=tiny_data)
    other = ("training.learning_rate=0.002", f"source.outputs={tmp_path}")
    assert "already trained" not in train(place[0], *other, data=tiny_data)


def test_a_failed_row_is_noted_and_the_others_run(tiny_data: Path, tmp_path: Path) -> None:
    seen = "positions=derendered,ground_truth"
    sweep = ("-m", "scenario=collision", seen, "model=copy_b", f"hydra.sweep.dir={tmp_path}")
    train(*sweep, data=tiny_data, code=1)  # there is no de-renderer yet
    assert "Traceback" not in next(tmp_path.glob("collision/all/copy_b/full/derendered/**/train.log")).read_text()
    assert "no de-renderer" in json.loads(next(tmp_path.rglob("failure.json")).read_text())["error"]
    assert [path.parts[-3] for path in tmp_path.rglob("metrics.json")] == ["ground_truth"]


@pytest.fixture
def users_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[object, ...]:
    """Arguments that choose a model of the user, which imports SCALE from a helper.py beside it."""
    (tmp_path / "own.py").write_text(
        "from dataclasses import replace\n\nfrom torch import nn\nfrom cophy.models.baselines import CopyC\nfrom helper import SCALE\n\n"
        "class Own(CopyC):\n    def __init__(self):\n        super().__init__()\n        self.linear = nn.Linear(3, 3)\n\n"
        "    def forward(self, inputs):\n        copied = super().forward(inputs)\n"
        "        return replace(copied, position=copied.position + SCALE * self.linear(copied.position))\n"
    )
    (tmp_path / "conf" / "model").mkdir(parents=True)
    (tmp_path / "conf" / "model" / "own.yaml").write_text("_target_: own.Own\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "--config-dir", tmp_path / "conf", "model=own", "scenario=collision"


@pytest.mark.slow
def test_a_training_of_other_code_is_not_reused(
    tiny_data: Path, tmp_path: Path, users_model: tuple[object, ...]
) -> None:
    place = (*users_model, f"hydra.run.dir={tmp_path / 'run'}")
    for scale, reused in ((1, False), (1, True), (2, False)):
        (tmp_path / "helper.py").write_text(f"SCALE = {scale}\n")
        assert ("already trained" in train(*place, data=tiny_data, apart=True)) == reused


@pytest.mark.slow
def test_a_model_that_crashes_in_a_sweep_leaves_its_traceback(
    tiny_data: Path, tmp_path: Path, users_model: tuple[object, ...]
) -> None:
    (tmp_path / "helper.py").write_text("SCALE = 'large'\n")
    train(*users_model, f"hydra.sweep.dir={tmp_path}", "hydra.mode=MULTIRUN", data=tiny_data, code=1, apart=True)
    logged = next(tmp_path.glob("collision/**/train.log")).read_text()
    assert "own.py" in logged
    assert "TypeError" in logged


def test_checkpoints_of_an_earlier_training_are_not_tested(copied_run: Path, tiny_data: Path) -> None:
    """A training that never validates has no best checkpoint; the old one must not stand in for it."""
    (copied_run / "metrics.json").unlink()  # with it, the directory is that of another run
    without = ("trainer.limit_val_batches=0", "training.learning_rate=0.001")
    train("scenario=collision", *without, f"hydra.run.dir={copied_run}", data=tiny_data, code=1)
    assert not (copied_run / "metrics.json").exists()
