"""Sweeps with runs side by side."""

import errno
import json
import os
from importlib.util import find_spec
from pathlib import Path

import pytest

from cophy.dataset.states import States
from tests.commands import train
from tests.conftest import raising, tiny_spec

ROWS = ("-m", "scenario=collision", "hydra/launcher=local", "hydra.launcher.n_jobs=2")


@pytest.mark.slow
def test_runs_side_by_side_make_missing_data_once(tmp_path: Path) -> None:
    places = (f"hydra.sweep.dir={tmp_path / 'outputs'}", "+row=copy_b,copy_c,in,npe")
    printed = train(*ROWS, *places, data=tmp_path / "data", apart=True)
    results = [json.loads(path.read_text()) for path in tmp_path.rglob("metrics.json")]
    assert {content["model"] for content in results} == {"copy_b", "copy_c", "in", "npe"}
    assert States(tiny_spec("collision"), tmp_path / "data").is_finished()
    assert printed.count("simulations, ") == 1  # said by the one run that made them
    assert "Done   4 out of   4" in printed
    assert "Epoch 0" not in printed  # bars of several runs would overwrite each other


@pytest.mark.slow
def test_all_runs_that_failed_are_listed_at_the_end(tiny_data: Path, tmp_path: Path) -> None:
    note = tmp_path / "of_another_sweep" / "failure.json"  # that fails while this one runs
    note.parent.mkdir()
    note.write_text(json.dumps({"error": "not ours", "sweep": "another"}))
    os.utime(note, (2**32, 2**32))
    failing = (f"hydra.sweep.dir={tmp_path}", "+row=copy_b,in", "positions=derendered,ground_truth")
    printed = train(*ROWS, *failing, data=tiny_data, code=1, apart=True).strip().splitlines()
    assert printed[-3].endswith("train.py: 2 runs failed; the same command runs them again")
    assert all("CophyError: no de-renderer of collision" in line for line in printed[-2:])
    assert len(list(tmp_path.rglob("metrics.json"))) == 2
    note.unlink()
    assert len(list(tmp_path.rglob("failure.json"))) == 2


@pytest.mark.skipif(find_spec("submitit") is None, reason="not installed: pip install 'cophy[cluster]'")
def test_without_slurm_its_launcher_says_so(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    jobs = ("-m", "scenario=collision", "model=copy_c", "hydra/launcher=slurm", f"hydra.sweep.dir={tmp_path}")
    assert "there is no srun here" in train(*jobs, data=tiny_data, code=1)


def test_a_disk_that_is_full_before_a_run_begins_is_named(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hydra writes a run's configuration first, and its error names no file."""

    monkeypatch.setattr("hydra.core.utils._save_config", raising(errno.ENOSPC))
    sweep = ("-m", "scenario=collision", "+row=copy_b", "seed=0,1", f"hydra.sweep.dir={tmp_path}")
    printed = train(*sweep, data=tiny_data, code=1)
    assert "No space left on device" in printed
    assert "run the same command to continue" in printed
    assert "Traceback" not in printed
