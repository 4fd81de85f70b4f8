"""A training that is stopped continues to the result it would have had, with the same command."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from cophy.errors import CophyError
from cophy.oracles.run import Oracle
from cophy.training import PredictionModule
from tests.commands import ON_TWO, train, without_times
from tests.conftest import ROOT

EPOCHS = 40
KEYS = ("scenario=collision", "model=in", f"trainer.max_epochs={EPOCHS}")


def result(directory: Path) -> dict:
    return json.loads((directory / "metrics.json").read_text())


def stopped(directory: Path, data: Path, how: signal.Signals, *devices: str) -> int:
    """Start the training, stop it after a further epoch, and return its exit code."""
    command = [sys.executable, str(ROOT / "src/train.py"), *KEYS, *devices, "size=tiny", f"data_dir={data}"]
    last = directory / "checkpoints" / "last.ckpt"
    before = last.stat().st_mtime_ns if last.exists() else 0
    process = subprocess.Popen([*command, f"hydra.run.dir={directory}"], stderr=subprocess.PIPE, text=True)
    while process.poll() is None and (not last.exists() or last.stat().st_mtime_ns == before):
        time.sleep(0.01)
    process.send_signal(how)
    _, printed = process.communicate(timeout=60)
    assert not (directory / "metrics.json").exists(), printed
    assert devices or "Traceback" not in printed  # a process that loses the others cannot help one
    return process.returncode


class Killed(BaseException):
    """The end of a process, which nothing in it can handle."""


def test_a_killed_training_continues_to_the_result_it_would_have_had(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill_in_second_epoch(module: PredictionModule) -> None:
        if module.current_epoch == 1:
            raise Killed

    keys = ("scenario=collision", "trainer.max_epochs=3")
    train(*keys, f"hydra.run.dir={tmp_path / 'whole'}", data=tiny_data)
    part = (*keys, f"hydra.run.dir={tmp_path / 'part'}")
    with monkeypatch.context() as patched:
        patched.setattr(PredictionModule, "on_train_epoch_start", kill_in_second_epoch, raising=False)
        with pytest.raises(Killed):
            train(*part, data=tiny_data)
    assert not (tmp_path / "part" / "metrics.json").exists()
    assert "continues where it stopped" in train(*part, data=tiny_data)
    whole, resumed = result(tmp_path / "whole"), result(tmp_path / "part")
    assert (whole["resumed"], resumed["resumed"]) == (0, 1)
    assert without_times(whole) == without_times(resumed)


def test_sigterm_ends_the_simulation_of_an_oracle_at_once(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_handler(*_: object) -> None:
        raise CophyError(f"handler {signal.getsignal(signal.SIGTERM)!r}")

    monkeypatch.setattr(Oracle, "forecast", read_handler)
    keys = ("scenario=collision", "model=oracle_feedforward", f"hydra.run.dir={tmp_path}")
    assert f"handler {signal.SIG_DFL!r}" in train(*keys, data=tiny_data, code=1)


@pytest.mark.slow
@pytest.mark.parametrize("keys", [(), ("optimizer=adam",), ON_TWO], ids=["one device", "Adam", "two devices"])
def test_a_stopped_training_continues_to_the_result_it_would_have_had(
    tiny_data: Path, tmp_path: Path, keys: tuple[str, ...]
) -> None:
    apart = keys is ON_TWO
    train(*KEYS, *keys, f"hydra.run.dir={tmp_path / 'whole'}", data=tiny_data, apart=apart)
    part = tmp_path / "part"
    assert stopped(part, tiny_data, signal.SIGTERM, *keys) == 128 + signal.SIGTERM
    assert stopped(part, tiny_data, signal.SIGKILL, *keys) == -signal.SIGKILL
    printed = train(*KEYS, *keys, f"hydra.run.dir={part}", data=tiny_data, apart=apart)
    assert f"continues where it stopped: {part / 'checkpoints' / 'last.ckpt'}" in printed
    whole, resumed = result(tmp_path / "whole"), result(part)
    assert (whole["resumed"], resumed["resumed"]) == (0, 2)
    assert without_times(whole) == without_times(resumed)
    assert "already trained" in train(*KEYS, *(() if apart else keys), f"hydra.run.dir={part}", data=tiny_data)
    assert result(part)["resumed"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("other", ["training.learning_rate=0.003", "reuse=false"])
def test_another_training_does_not_go_on_with_it(tiny_data: Path, tmp_path: Path, other: str) -> None:
    stopped(tmp_path, tiny_data, signal.SIGKILL)
    last = (tmp_path / "checkpoints" / "last.ckpt").read_bytes()
    assert "continues" not in train(*KEYS, other, f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert result(tmp_path)["resumed"] == 0
    assert (tmp_path / "checkpoints" / "last_of_stopped.ckpt").read_bytes() == last  # hours of work, perhaps


def test_a_longer_training_continues_with_the_best_so_far(trained_run: Path, tiny_data: Path, tmp_path: Path) -> None:
    """Its further epoch is not validated, so that the best one is of the shorter training."""
    best = torch.load(trained_run / "checkpoints" / "best.ckpt", weights_only=True)
    keys = (
        "scenario=collision",
        "trainer.max_epochs=2",
        "trainer.limit_val_batches=0",
        f"hydra.run.dir={tmp_path / 'long'}",
    )
    ckpt = f"ckpt={trained_run / 'checkpoints' / 'last.ckpt'}"
    train(*keys, ckpt, data=tiny_data)
    tested = torch.load(tmp_path / "long" / "checkpoints" / "best.ckpt", weights_only=True)
    assert tested["global_step"] == best["global_step"]
    assert result(tmp_path / "long")["validation"] == result(trained_run)["validation"]
    assert result(tmp_path / "long")["resumed"] == 1
    assert "already trained" in train(*keys, ckpt, data=tiny_data)


def test_a_time_limit_ends_the_training(tiny_data: Path, tmp_path: Path) -> None:
    keys = (*KEYS[:2], "trainer.max_epochs=-1", "schedule=constant", "trainer.max_time=00:00:00:01")
    train(*keys, f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert 1 <= result(tmp_path)["training_seconds"] < 20
    last = tmp_path / "checkpoints" / "last.ckpt"
    train(*keys, f"ckpt={last}", f"hydra.run.dir={tmp_path / 'resumed'}", data=tiny_data)
    assert not (tmp_path / "resumed" / "checkpoints" / "last.ckpt").exists()  # its time is over
