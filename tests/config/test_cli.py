"""Unusable values end a command with one line that names them, before anything is generated."""

from pathlib import Path

import pytest

from tests.commands import run

REFUSED = [  # override, and what the error must contain; values that are refused in composing: see test_config.py
    ("model.hidden_dim=10000000000", "model: not enough memory"),
    ("trainer.accelerator=foo", "trainer: You selected an invalid accelerator name"),
    ("trainer.devices=1000", "trainer.devices=1000 starts as many processes"),
    pytest.param("trainer.devices=0", "trainer: ", marks=pytest.mark.slow),
    pytest.param("trainer.max_time=foo", "trainer: ", marks=pytest.mark.slow),
    pytest.param("trainer.limit_train_batches=-1", "trainer: ", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("override", "message"), REFUSED)
def test_a_bad_value_ends_with_one_line_before_anything_is_generated(
    override: str, message: str, tmp_path: Path
) -> None:
    words = (f"data_dir={tmp_path / 'data'}", f"hydra.run.dir={tmp_path / 'run'}", "logger=[]", "size=tiny")
    printed = run("train", "scenario=collision", "model=in", *words, override, code=1)
    (line,) = printed.strip().splitlines()[-1:]
    assert message in line
    assert "Traceback" not in printed
    assert "Error executing job" not in printed
    assert not (tmp_path / "data").exists()


NO_FOLDERS = [
    ("look", "directory=", "directory= is empty: it names a folder"),
    ("look", "directory=/proc/x", "/proc/x: No such file or directory"),
    ("export", "root=/proc/x", "/proc/x: No such file or directory"),
    pytest.param("audit", "directory=/proc/x", "/proc/x: No such file or directory", marks=pytest.mark.slow),
    pytest.param("export", "root=", "root= is empty: it names a folder", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("command", "override", "message"), NO_FOLDERS)
def test_an_impossible_folder_is_refused_before_anything_is_generated(
    command: str, override: str, message: str, tmp_path: Path
) -> None:
    printed = run(command, "scenario=collision", "size=tiny", f"data_dir={tmp_path / 'data'}", override, code=1)
    (line,) = printed.strip().splitlines()
    assert line.endswith(f"src/{command}.py: {message}")
    assert not (tmp_path / "data").exists()
