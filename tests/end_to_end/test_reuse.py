"""A finished training is reused."""

import json
from pathlib import Path

import pytest
import torch

from cophy.atomic_files import sha256
from cophy.report.runs import read_line
from tests.commands import train

RUN = "seed0+size-tiny+max_epochs-1"
HALVES = ("scenario=balls", "trainer.max_epochs=1")


def result(root: Path, split: str) -> dict:
    return json.loads((root / f"balls/{split}/cophynet/full/ground_truth/{RUN}/metrics.json").read_text())


def curves_in(root: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in root.rglob("events.out.tfevents.*")}


def test_splits_with_the_same_training_half_train_once(tiny_data: Path, tmp_path: Path) -> None:
    printed = train("-m", *HALVES, "split=4to4,4to3", f"hydra.sweep.dir={tmp_path}", data=tiny_data)
    assert printed.count("already trained") == 1
    assert str(tmp_path / f"balls/4to4/cophynet/full/ground_truth/{RUN}/checkpoints") in printed
    assert result(tmp_path, "4to3")["metrics"]["mse"] != result(tmp_path, "4to4")["metrics"]["mse"]
    assert result(tmp_path, "4to3")["training_seconds"] == result(tmp_path, "4to4")["training_seconds"]
    named = "scenario.task.splits=[4to4,4to2,4to3,4to5,4to6,mine]"  # a split more does not train the others again
    assert "already trained" in train("-m", *HALVES, named, "split=4to3", f"hydra.sweep.dir={tmp_path}", data=tiny_data)
    alone = train(*HALVES, "split=4to3", f"hydra.run.dir={tmp_path / 'alone'}", data=tiny_data)
    assert "already trained" not in alone
    metrics = json.loads((tmp_path / "alone" / "metrics.json").read_text())["metrics"]
    assert metrics == result(tmp_path, "4to3")["metrics"]  # reuse changes no number


def test_a_given_checkpoint_is_tested_instead_of_training(tiny_data: Path, tmp_path: Path) -> None:
    train(*HALVES, "split=4to4", f"source.outputs={tmp_path}", data=tiny_data)
    kept = tmp_path / "kept.ckpt"
    kept.write_bytes((tmp_path / f"balls/4to4/cophynet/full/ground_truth/{RUN}/checkpoints/best.ckpt").read_bytes())
    train(*HALVES, "split=4to3", f"source.outputs={tmp_path}", data=tiny_data)
    trained = result(tmp_path, "4to3")
    elsewhere = (*HALVES, "split=4to3", f"predictor={kept}", f"source.outputs={tmp_path / 'elsewhere'}")
    train(*elsewhere, data=tiny_data)
    tested = result(tmp_path / "elsewhere", "4to3")
    alike = ("metrics", "intervals", "validation", "max_epochs", "dataset_ids", "variant")
    assert [tested[key] for key in alike] == [trained[key] for key in alike]
    assert (trained["predictor"], tested["predictor"]) == (None, sha256(kept)[:8])
    assert tested["training_seconds"] == 0
    line = read_line(next((tmp_path / "elsewhere").rglob("metrics.json")))
    assert line["is_trained"]  # not here, but it is no copy
    assert not list((tmp_path / "elsewhere").rglob("*.ckpt"))
    for key, own in {
        "seed=1": "seed=0",
        "trainer.max_epochs=2": "trainer.max_epochs=1",
        "optimizer=soap": "_target_",
    }.items():
        printed = train(*elsewhere, key, data=tiny_data, code=1)
        assert f"{kept} belongs to another training (" in printed
        assert own in printed
    assert "metrics.json belongs to a training with these settings" in train(
        *HALVES, "split=4to3", f"predictor={kept}", f"source.outputs={tmp_path}", data=tiny_data, code=1
    )
    assert result(tmp_path, "4to3") == trained
    train(*elsewhere, data=tiny_data)  # its own it may replace


def test_a_checkpoint_that_does_not_state_its_seed_is_not_tested(tiny_data: Path, tmp_path: Path) -> None:
    train(*HALVES, "split=4to4", "model=in", f"hydra.run.dir={tmp_path}", data=tiny_data)
    best = tmp_path / "checkpoints" / "best.ckpt"
    saved = torch.load(best, weights_only=True)
    del saved["origin"]["seed"], saved["origin"]["trainer"]
    torch.save(saved, best)
    given = (f"predictor={best}", f"hydra.run.dir={tmp_path / 'tested'}", "model=in")
    assert "does not state its seed" in train(*HALVES, *given, data=tiny_data, code=1)


def test_a_training_on_half_of_the_data_takes_twice_the_epochs(tiny_data: Path, tmp_path: Path) -> None:
    train("trainer.max_epochs=1", "split=3to3_unseen", f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert json.loads((tmp_path / "metrics.json").read_text())["max_epochs"] == 2
    assert torch.load(tmp_path / "checkpoints" / "last.ckpt", weights_only=True)["epoch"] == 1


@pytest.mark.slow
def test_curves_are_of_the_last_training_alone(tiny_data: Path, tmp_path: Path) -> None:
    place = (*HALVES, f"source.outputs={tmp_path}", "logger=[tensorboard]", "figures_every_n_epochs=9", "model=in")
    train(*place, data=tiny_data, apart=True)
    first = curves_in(tmp_path)
    assert "already trained" in train(*place, data=tiny_data, apart=True)
    assert curves_in(tmp_path) == first
    train(*place, "reuse=false", data=tiny_data, apart=True)
    assert not curves_in(tmp_path).keys() & first.keys()


def test_another_training_is_not_reused(tiny_data: Path, tmp_path: Path) -> None:
    place = (*HALVES, f"source.outputs={tmp_path}")
    train(*place, data=tiny_data)
    assert "already trained" in train(*place, data=tiny_data)
    assert "already trained" not in train(*place, "reuse=false", data=tiny_data)
    assert "already trained" not in train(*place, "training.learning_rate=0.002", data=tiny_data)
    assert "already trained" not in train(*place, "seed=1", data=tiny_data)


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


def test_a_training_of_other_code_is_not_reused(
    tiny_data: Path, tmp_path: Path, users_model: tuple[object, ...]
) -> None:
    place = (*users_model, f"hydra.run.dir={tmp_path / 'run'}")
    for scale, reused in ((1, False), (1, True), (2, False)):
        (tmp_path / "helper.py").write_text(f"SCALE = {scale}\n")
        assert ("already trained" in train(*place, data=tiny_data, apart=True)) == reused


def test_a_model_that_crashes_in_a_sweep_leaves_its_traceback(
    tiny_data: Path, tmp_path: Path, users_model: tuple[object, ...]
) -> None:
    (tmp_path / "helper.py").write_text("SCALE = 'large'\n")
    train(*users_model, f"hydra.sweep.dir={tmp_path}", "hydra.mode=MULTIRUN", data=tiny_data, code=1, apart=True)
    logged = next(tmp_path.glob("collision/**/train.log")).read_text()
    assert "own.py" in logged
    assert "TypeError" in logged


def test_checkpoints_of_an_earlier_training_are_not_tested(tiny_data: Path, tmp_path: Path) -> None:
    """A training that never validates has no best checkpoint; the old one must not stand in for it."""
    train("scenario=collision", f"hydra.run.dir={tmp_path}", data=tiny_data)
    (tmp_path / "metrics.json").unlink()  # with it, the directory is that of another run
    without = ("trainer.limit_val_batches=0", "training.learning_rate=0.001")
    train("scenario=collision", *without, f"hydra.run.dir={tmp_path}", data=tiny_data, code=1)
    assert not (tmp_path / "metrics.json").exists()
