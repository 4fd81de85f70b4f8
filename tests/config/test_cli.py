"""Unusable values end a command with one line that names them, before anything is generated."""

from pathlib import Path

import pytest

from tests.commands import run

REFUSED = [  # override, and what the error must contain
    ("seed=99999999999", "seed=99999999999 must be from 0 to"),
    ("model.hidden_dim=10000000000", "model: not enough memory"),
    ("trainer.accelerator=foo", "trainer: You selected an invalid accelerator name"),
    ("trainer.devices=0", "trainer: "),
    ("trainer.devices=1000", "trainer.devices=1000 starts as many processes"),
    ("trainer.max_time=foo", "trainer: "),
    ("trainer.check_val_every_n_epoch=0", "trainer.check_val_every_n_epoch=0 must be at least 1"),
    ("trainer.check_val_every_n_epoch=50", "trainer.check_val_every_n_epoch=50 must be at most trainer.max_epochs"),
    ("trainer.limit_train_batches=-1", "trainer: "),
    ("trainer.limit_train_batches=0", "trainer.limit_train_batches=0: at least one batch"),
    ("scenario.min_difference=1e9", "scenario.min_difference=1e+09 m must be at most"),
    ("size.name=../../../evil", "size.name=../../../evil: a name has"),
    ("scenario.name=..", "scenario.name=..: a name has"),
    ("scenario.name=balls", "scenario.name=balls is the name of another scenario"),
    ("render.modalities=[rgb,rgb]", "names a modality twice"),
    ("scenario.camera.eye=[0,0]", "camera: eye and target must be two different points"),
    ("scenario.camera.field_of_view_deg=0", "camera.field_of_view_deg=0"),
    ("data_dir=", "data_dir= is empty"),
]


@pytest.mark.parametrize(("override", "message"), REFUSED, ids=[override for override, _ in REFUSED])
def test_a_bad_value_ends_with_one_line_before_anything_is_generated(
    override: str, message: str, tmp_path: Path
) -> None:
    defaults = {"data_dir": tmp_path / "data", "hydra.run.dir": tmp_path / "run", "logger": "[]", "size": "tiny"}
    words = [f"{key}={value}" for key, value in defaults.items() if key != override.partition("=")[0]]
    printed = run("train", "scenario=collision", "model=in", *words, override, code=1)
    (line,) = printed.strip().splitlines()[-1:]
    assert message in line
    assert "Traceback" not in printed
    assert "Error executing job" not in printed
    assert not (tmp_path / "data").exists()


NO_FOLDERS = [
    ("look", "directory=", "directory= is empty: it names a folder"),
    ("look", "directory=/proc/x", "/proc/x: No such file or directory"),
    ("audit", "directory=/proc/x", "/proc/x: No such file or directory"),
    ("export", "root=", "root= is empty: it names a folder"),
    ("export", "root=/proc/x", "/proc/x: No such file or directory"),
]


@pytest.mark.parametrize(("command", "override", "message"), NO_FOLDERS)
def test_an_impossible_folder_is_refused_before_anything_is_generated(
    command: str, override: str, message: str, tmp_path: Path
) -> None:
    printed = run(command, "scenario=collision", "size=tiny", f"data_dir={tmp_path / 'data'}", override, code=1)
    (line,) = printed.strip().splitlines()
    assert line.endswith(f"src/{command}.py: {message}")
    assert not (tmp_path / "data").exists()
