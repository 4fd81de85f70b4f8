"""Runs that want the same directory."""

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.training.run import FAILURE, Measured, Run, claimed, write_metrics


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run("balls", "4to4", "cophynet", "full", "ground_truth", 1, "tiny", "", tmp_path / "run")


def finish(run: Run) -> None:
    run.directory.mkdir(exist_ok=True)
    write_metrics(run, Measured({"mse": np.array([1.0, 3.0])}, np.array([0, 0])), {})


def test_one_process_at_a_time_makes_a_run(run: Run) -> None:
    with claimed(run):
        with pytest.raises(CophyError, match="another process is making this run"), claimed(run):
            raise AssertionError("two at once")
        finish(run)
    assert sorted(path.name for path in run.directory.iterdir()) == [".lock", "metrics.json"]


def test_the_same_run_forgets_its_earlier_results_when_it_begins(run: Run) -> None:
    with claimed(run):
        finish(run)
    with claimed(run) as claim:
        assert (run.directory / "metrics.json").exists()
        claim.begin(tests_checkpoint=False)
        assert not (run.directory / "metrics.json").exists()


def test_what_is_refused_before_it_begins_keeps_earlier_results(run: Run) -> None:
    with claimed(run):
        finish(run)
    with pytest.raises(CophyError, match="no file"), claimed(run):
        raise CophyError("ckpt=nowhere is no file")
    assert (run.directory / "metrics.json").exists()
    assert json.loads((run.directory / "failure.json").read_text())["has_begun"] is False


def test_the_results_of_another_run_are_not_replaced(run: Run) -> None:
    with claimed(run):
        finish(run)
    other = replace(run, variant="+hidden_dim-8")
    with pytest.raises(CophyError, match=r"is of another run \(variant=\)"), claimed(other):
        raise AssertionError("replaced")
    assert (run.directory / "metrics.json").exists()
    assert not (run.directory / "failure.json").exists()


def test_results_without_a_variant_are_those_of_their_names(run: Run) -> None:
    finish(run)
    path = run.directory / "metrics.json"
    content = json.loads(path.read_text())
    del content["variant"]
    path.write_text(json.dumps(content))
    with pytest.raises(CophyError, match=r"is of another run \(seed=1\)"), claimed(replace(run, seed=2)):
        raise AssertionError("replaced")
    with claimed(run) as claim:
        claim.begin(tests_checkpoint=False)
        assert not path.exists()


def test_what_fails_leaves_a_note(run: Run) -> None:
    with pytest.raises(ValueError, match="broken"), claimed(run):
        raise ValueError("broken")
    assert (run.directory / "failure.json").exists()
    with claimed(run):
        finish(run)
    assert not (run.directory / "failure.json").exists()


def test_a_full_disk_is_named_with_what_is_safe(run: Run) -> None:
    with pytest.raises(CophyError, match=f"no space left for {run.directory}: finished runs.* are safe"), claimed(run):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert "No space left" in (run.directory / FAILURE).read_text()
