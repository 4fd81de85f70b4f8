"""A checkpoint from elsewhere may name any path: nothing outside the run's checkpoints is removed."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.commands import ON_TWO, train
from tests.conftest import quick_first

KEYS = ("scenario=collision",)


def point_to(last: Path, target: str, directory: str) -> None:
    """Let every ModelCheckpoint state of a checkpoint claim that its earlier checkpoints are at `target`."""
    checkpoint = torch.load(last, weights_only=True)
    names = [name for name in checkpoint["callbacks"] if "ModelCheckpoint" in name]
    assert len(names) == 2
    for name in names:
        checkpoint["callbacks"][name] = {
            **dict.fromkeys(("best_model_path", "kth_best_model_path", "last_model_path"), target),
            "dirpath": directory,
            "best_k_models": {target: torch.tensor(1e9)},
            "best_model_score": torch.tensor(1e9),
            "kth_value": torch.tensor(1e9),
            "current_score": torch.tensor(1e9),
            "monitor": None,
        }
    torch.save(checkpoint, last)


@pytest.mark.parametrize(("named", "is_outputs"), [("local://{}", False), ("{}/run/checkpoints/../../victim", True)])
def test_no_folder_is_removed(tiny_data: Path, tmp_path: Path, copied_run: Path, named: str, is_outputs: bool) -> None:
    victim, run = tmp_path / "victim", tmp_path / "run"
    victim.mkdir()
    (victim / "thesis.txt").write_text("three years")
    last, keys = copied_run / "checkpoints" / "last.ckpt", [f"ckpt={copied_run / 'checkpoints' / 'last.ckpt'}"]
    if is_outputs:  # an unfinished run, stopped after its first epoch: the same command continues it
        train(*KEYS, "trainer.max_epochs=2", f"hydra.run.dir={run}", data=tiny_data)
        last, keys = last.replace(run / "checkpoints" / "last.ckpt"), []
        (run / "metrics.json").unlink()
        (run / "checkpoints" / "finished.json").replace(run / "checkpoints" / "begun.json")
    point_to(last, named.format(tmp_path if is_outputs else victim), str((run / "checkpoints").resolve()))
    train(*KEYS, "trainer.max_epochs=2", *keys, f"hydra.run.dir={run}", data=tiny_data)
    assert (victim / "thesis.txt").read_text() == "three years"
    assert (run / "metrics.json").exists()


@pytest.mark.slow
def test_two_devices_remove_no_folder(tiny_data: Path, tmp_path: Path, copied_run: Path) -> None:
    victim, run, last = tmp_path / "victim", tmp_path / "run", copied_run / "checkpoints" / "last.ckpt"
    victim.mkdir()
    (victim / "thesis.txt").write_text("three years")
    point_to(last, f"local://{victim}", str((run / "checkpoints").resolve()))
    keys = (*ON_TWO, "trainer.max_epochs=2", f"ckpt={last}", f"hydra.run.dir={run}")
    train(*KEYS, *keys, data=tiny_data, apart=True)
    assert (victim / "thesis.txt").read_text() == "three years"
    assert (run / "metrics.json").exists()


def test_lightnings_own_checkpoint_of_slurm_is_refused(
    tiny_data: Path, tmp_path: Path, copied_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On SLURM, Lightning prefers a file of this name to a new training, and reads it without a check."""
    (tmp_path / "run").mkdir()
    shutil.copyfile(copied_run / "checkpoints" / "last.ckpt", tmp_path / "run" / "hpc_ckpt_1.ckpt")
    names = ("SLURM_NTASKS", "SLURM_PROCID", "SLURM_LOCALID", "SLURM_NODEID", "SLURM_JOB_ID", "SLURM_JOB_NAME")
    for name, value in zip(names, "10001x", strict=True):
        monkeypatch.setenv(name, value)
    printed = train(*KEYS, f"hydra.run.dir={tmp_path / 'run'}", data=tiny_data, code=1)
    assert "hpc_ckpt_1.ckpt: Lightning would continue from it, but train.py writes no such file: delete it" in printed
    assert "Traceback" not in printed


STRANGE: dict[str, Callable[[dict[str, Any]], object]] = {
    "loops": lambda checkpoint: checkpoint.update(loops=5),
    "loop": lambda checkpoint: checkpoint["loops"].pop("fit_loop"),
    "optimiser": lambda checkpoint: checkpoint.update(optimizer_states=[{}]),
    "schedule": lambda checkpoint: checkpoint.update(lr_schedulers=["x"]),
    "callback": lambda checkpoint: checkpoint["callbacks"].update(Stopwatch={"seconds": "x"}),
    "metrics": lambda checkpoint: checkpoint["callbacks"].update(BestValidation={"val/loss": 1.0}),
    "weights": lambda checkpoint: checkpoint["state_dict"].update(more=torch.ones(1)),
}


@pytest.mark.parametrize("change", quick_first(STRANGE.values(), 2))
def test_a_checkpoint_with_strange_values_is_named(
    tiny_data: Path, tmp_path: Path, copied_run: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    last = copied_run / "checkpoints" / "last.ckpt"
    checkpoint = torch.load(last, weights_only=True)
    change(checkpoint)
    torch.save(checkpoint, last)
    keys = ("trainer.max_epochs=2", f"ckpt={last}", f"hydra.run.dir={tmp_path / 'run'}")
    printed = train(*KEYS, *keys, data=tiny_data, code=1)
    assert "last.ckpt was not written by train.py" in printed
    assert "Traceback" not in printed
