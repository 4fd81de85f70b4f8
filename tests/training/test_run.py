"""A run: its names and place, the lock on its directory, and the files of its results."""

import errno
import fcntl
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from cophy.cli import explain
from cophy.errors import CophyError
from cophy.training.predictor import prediction_arrays
from cophy.training.run import (
    TESTED_CHECKPOINT,
    Results,
    Run,
    differences,
    plain_value,
    read_predictions,
    write_predictions,
)
from cophy.types import Batch, Prediction
from tests.conftest import raising
from tests.report.stored_runs import leave


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run("balls", "4to4", "cophynet", "full", "ground_truth", 1, "tiny", "", tmp_path / "run")


def finish(run: Run, **facts: object) -> None:
    run.directory.mkdir(exist_ok=True)
    run.write_results(Results({"mse": np.array([1.0, 3.0, 2.0, 2.0])}, np.array([0, 0, 1, 1]), {"copy_c": 5.0}), facts)


def test_only_one_process_makes_a_run(run: Run) -> None:
    with run.locked():
        with pytest.raises(CophyError, match="another process is making this run"), run.locked():
            raise AssertionError("two at once")
        finish(run)
    assert sorted(path.name for path in run.directory.iterdir()) == [".lock", "metrics.json"]


def test_a_run_on_a_file_system_without_locks_names_the_remedy(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "flock", raising(errno.ENOLCK))
    with pytest.raises(CophyError, match=r"cannot lock files .* source\.outputs="), run.locked():
        raise AssertionError("it is not locked")


def test_a_run_deletes_its_earlier_results_when_it_begins(run: Run) -> None:
    with run.locked():
        finish(run)
    with run.locked():
        assert (run.directory / "metrics.json").exists()
        run.delete_earlier_results()
        assert not (run.directory / "metrics.json").exists()


def test_a_run_that_is_refused_keeps_earlier_results_and_notes_why(run: Run) -> None:
    finish(run)
    with pytest.raises(CophyError, match="not a file"), run.locked():
        raise CophyError("ckpt=nowhere is not\na file".replace("\n", " "))
    assert (run.directory / "metrics.json").exists()
    note = json.loads((run.directory / "failure.json").read_text())
    assert (note["has_begun"], note["error"]) == (False, "CophyError: ckpt=nowhere is not a file")
    with run.locked():
        assert not (run.directory / "failure.json").exists()


def test_results_of_another_run_are_not_replaced(run: Run) -> None:
    finish(run)
    other = replace(run, variant="+hidden_dim-8")
    with pytest.raises(CophyError, match=r"belongs to another run \(variant=\)"), other.locked():
        raise AssertionError("replaced")
    assert (run.directory / "metrics.json").exists()
    assert not (run.directory / "failure.json").exists()


def test_results_of_a_training_are_not_replaced_by_those_of_a_checkpoint(run: Run) -> None:
    finish(run)
    with pytest.raises(CophyError, match="belongs to a training"), run.locked(tests=TESTED_CHECKPOINT):
        raise AssertionError("replaced")
    finish(run, predictor="0123abcd")
    with run.locked(tests=TESTED_CHECKPOINT):
        pass


@pytest.mark.parametrize("text", ["{", "[]", ""])
def test_damaged_results_are_named_and_kept(run: Run, text: str) -> None:
    run.directory.mkdir()
    path = run.directory / "metrics.json"
    path.write_text(text)
    with pytest.raises(CophyError, match=r"metrics\.json .*delete it"), run.locked():
        raise AssertionError("ignored")
    assert path.read_text() == text


def test_a_full_disk_is_named_with_what_is_safe(run: Run) -> None:
    with pytest.raises(OSError, match=f"No space left on device: '{run.directory}'") as caught, run.locked():
        raise OSError(errno.ENOSPC, "No space left on device")
    assert "No space left on device; finished runs, shards and last checkpoints are safe" in explain(caught.value)
    assert "No space left" in (run.directory / "failure.json").read_text()


def test_metrics_are_means_with_their_intervals(run: Run) -> None:
    finish(run, num_test=4)
    content = json.loads((run.directory / "metrics.json").read_text())
    results = {"metrics": {"mse": 2.0}, "intervals": {"mse": [2.0, 2.0]}, "copies": {"copy_c": 5.0}}
    assert content == {**run.names(), "changes": {}, "num_test": 4, **results}


def test_predictions_are_read_as_they_were_written(tmp_path: Path, tower_batch: Batch) -> None:
    targets, experiments = tower_batch.targets, np.arange(len(tower_batch))[::-1]
    empty = ~targets.presence[:, None, :, None]
    position = (targets.position + 1).masked_fill(empty, torch.nan)
    logit, estimate = torch.ones_like(targets.position[:, :1, :, 0]), torch.ones(*targets.presence.shape, 8)
    write_predictions(
        tmp_path, prediction_arrays(Prediction(position, logit, estimate), targets, experiments, targets.pair.numpy())
    )
    arrays = read_predictions(tmp_path)
    np.testing.assert_array_equal(arrays["experiment"], experiments)
    np.testing.assert_array_equal(arrays["position"], (targets.position + 1).masked_fill(empty, 0.0).numpy())
    np.testing.assert_array_equal(arrays["cluster"], targets.pair)
    for name in ("stable", "presence", "initial", "pair", "cell"):
        np.testing.assert_array_equal(arrays[name], getattr(targets, name).numpy())
    np.testing.assert_array_equal(arrays["target"], targets.position.numpy())
    assert arrays["stable_logit"].shape == (len(tower_batch), 1, targets.presence.shape[1])
    np.testing.assert_array_equal(arrays["estimate"].all(axis=-1), targets.observed_presence.numpy())
    path = tmp_path / "predictions.npz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CophyError, match=r"predictions\.npz is missing or damaged"):
        read_predictions(tmp_path)


WRONG = {
    "stable_logit": np.zeros((4, 2, 3)),
    "estimate": np.zeros((4, 3)),
    "probe_mass": np.zeros((4, 3)),
    "probe_most_frequent": np.zeros(3, dtype=np.int16),
    "experiment": np.arange(4.0),
    "stable": np.ones((4, 5, 3)),
    "cell": np.zeros(5, dtype=np.int64),
    "draw_variance": np.full((4, 5, 3, 3), np.inf),
}


@pytest.mark.parametrize("name", WRONG)
def test_arrays_of_another_shape_or_type_are_named(name: str, tmp_path: Path) -> None:
    leave(tmp_path, "{}")
    write_predictions(tmp_path, read_predictions(tmp_path) | {name: WRONG[name]})
    with pytest.raises(CophyError, match=rf"predictions\.npz is missing or damaged \(.* {name}\)"):
        read_predictions(tmp_path)


def test_a_pipe_is_no_file_of_predictions(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "predictions.npz")
    with pytest.raises(CophyError, match="not a regular file"):
        read_predictions(tmp_path)


def test_predictions_that_may_not_be_read_are_not_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", raising(errno.EACCES))
    with pytest.raises(PermissionError):
        read_predictions(tmp_path)


def test_a_run_at_its_place_knows_the_root_of_all_runs(run: Run) -> None:
    run = replace(run, variant="+size-tiny")
    place = Path("balls/4to4/cophynet/full/ground_truth/seed1+size-tiny")
    assert replace(run, directory=Path("outputs") / place).root == Path("outputs")
    assert replace(run, directory=Path("elsewhere")).root is None
    names = ["scenario", "split", "model", "ablation", "positions", "seed", "size", "variant"]
    assert list(run.names()) == names


def test_short_names_differ(run: Run) -> None:
    runs = [run, replace(run, ablation="feedforward"), replace(run, positions="derendered"), replace(run, seed=0)]
    assert [each.short_name for each in runs] == [
        "balls_4to4_cophynet_seed1",
        "balls_4to4_cophynet_feedforward_seed1",
        "balls_4to4_cophynet_derendered_seed1",
        "balls_4to4_cophynet_seed0",
    ]


def test_only_keys_that_change_results_are_differences() -> None:
    config = {"trainer": {"max_epochs": 2, "devices": 2}, "size": {"num_experiments": 40}}
    expected = {"trainer": {"max_epochs": 40, "devices": 1}, "size": {"num_experiments": 40}}
    assert list(differences("cfg", config, expected)) == [("cfg.trainer.devices", 2), ("cfg.trainer.max_epochs", 2)]
    assert list(differences("trainer", config["trainer"], expected["trainer"])) == [("trainer.max_epochs", 2)]
    assert list(differences("model", {"dim": 8, "new": 1}, {"dim": 8})) == [("model.new", 1)]


def test_a_plain_value_has_its_references_resolved() -> None:
    config = OmegaConf.create({"a": {"b": "${c}"}, "c": 3})
    assert plain_value(config, "a") == {"b": 3}
    assert plain_value(config, "c") == 3
    assert plain_value(config, "missing") is None
