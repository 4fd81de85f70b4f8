"""Values that nothing can be done with end a command in one line that names them, before anything is made."""

from pathlib import Path

import pytest

from tests.commands import run

REFUSED = [  # what is said, and what has to be in the answer
    ("seed=99999999999", "seed=99999999999 must be at most"),
    ("threads=1000000", "threads=1000000 must be at most"),
    ("model.hidden_dim=10000000000", "model: there is no memory"),
    ("training.learning_rate=nan", "training.learning_rate=nan must be a finite number"),
    ("trainer.gradient_clip_val=nan", "trainer.gradient_clip_val=nan must be a finite number"),
    ("trainer.accelerator=foo", "trainer: You selected an invalid accelerator name"),
    ("trainer.accelerator=cuda", "trainer: "),
    ("trainer.devices=0", "trainer: "),
    ("trainer.devices=1000", "trainer.devices=1000 starts as many processes"),
    ("trainer.devices=abc", "trainer: "),
    ("trainer.devices=[]", "trainer: "),
    ("trainer.precision=foo", "trainer: Precision 'foo' is invalid"),
    ("trainer.strategy=foo", "trainer: You selected an invalid strategy name"),
    ("trainer.max_time=foo", "trainer: "),
    ("trainer.profiler=foo", "trainer: "),
    ("trainer.num_nodes=0", "trainer: "),
    ("trainer.check_val_every_n_epoch=0", "trainer.check_val_every_n_epoch=0 must be at least 1"),
    ("trainer.check_val_every_n_epoch=50", "trainer.check_val_every_n_epoch=50 must be at most trainer.max_epochs"),
    ("trainer.limit_train_batches=-1", "trainer: "),
    ("trainer.limit_train_batches=0", "trainer.limit_train_batches=0: at least one batch"),
    ("trainer.limit_val_batches=0", "trainer.limit_val_batches=0: at least one batch"),
    ("trainer.limit_test_batches=0", "trainer.limit_test_batches=0: at least one batch"),
    ("scenario.gravity_z=nan", "scenario.gravity_z=nan must be a finite number"),
    ("scenario.gravity_z=inf", "scenario.gravity_z=inf must be a finite number"),
    ("scenario.confounders.mass=[nan]", "scenario.confounders.mass.0=nan must be a finite number"),
    ("scenario.min_difference=1e9", "scenario.min_difference=1e+09 m: in this scenario nothing moves farther"),
    ("size.name=../../../evil", "size.name=../../../evil: a name has"),
    ("scenario.name=..", "scenario.name=..: a name has"),
    ("scenario.name=balls", "scenario.name=balls is the name of another scenario"),
    ("render.modalities=[rgb,rgb]", "names one twice"),
    ("scenario.camera.eye=[0,0]", "camera: eye and target are two points"),
    ("scenario.camera.field_of_view_deg=0", "camera.field_of_view_deg=0"),
    ("data_dir=", "data_dir= is empty"),
]


@pytest.mark.parametrize(("word", "said"), REFUSED, ids=[word for word, _ in REFUSED])
def test_refused_in_one_line_before_anything_is_made(word: str, said: str, tmp_path: Path) -> None:
    usual = {"data_dir": tmp_path / "data", "hydra.run.dir": tmp_path / "run", "logger": "[]", "size": "tiny"}
    words = [f"{key}={value}" for key, value in usual.items() if key != word.partition("=")[0]]
    printed = run("train", "scenario=collision", "model=in", *words, word, code=1)
    (line,) = printed.strip().splitlines()[-1:]
    assert said in line
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


@pytest.mark.parametrize(("command", "word", "said"), NO_FOLDERS)
def test_what_can_be_no_folder_is_refused_before_anything_is_made(
    command: str, word: str, said: str, tmp_path: Path
) -> None:
    printed = run(command, "scenario=collision", "size=tiny", f"data_dir={tmp_path / 'data'}", word, code=1)
    (line,) = printed.strip().splitlines()
    assert line.endswith(f"src/{command}.py: {said}")
    assert not (tmp_path / "data").exists()
