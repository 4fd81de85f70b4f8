"""Unusable values end a command with one line that names them, before anything is generated."""

import errno
import logging
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from cophy.cli import LogFile, explain, is_user_error, print_error_of_thread
from tests.commands import python, run
from tests.conftest import ROOT, raising

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


@pytest.mark.parametrize(("option", "message"), [("--resolve", "--cfg"), ("hydra.searchpath=[x://y]", "schema x")])
def test_what_hydra_refuses_is_one_line(option: str, message: str) -> None:
    (line,) = run("report", option, code=1).strip().splitlines()
    assert message in line


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS])
@pytest.mark.parametrize("file", [None, "outputs/x"])
def test_an_error_of_a_disk_is_one_line_with_its_meaning(number: int, file: str | None) -> None:
    error = OSError(number, os.strerror(number), file)
    assert is_user_error(error)
    line = explain(error)
    assert os.strerror(number) in line
    assert file is None or line.startswith("outputs/x: ")
    assert ("free some space" in line) == (number in (errno.ENOSPC, errno.EDQUOT))


@pytest.mark.parametrize("words", [(), ("-m", "seed=0,1")])
def test_outputs_without_a_name_are_refused(words: tuple[str, ...]) -> None:
    printed = run("train", *words, "scenario=collision", "model=copy_b", "size=tiny", "source.outputs=", code=1)
    assert printed.strip().splitlines()[-1].endswith("train.py: source.outputs= is empty: it names a folder")
    assert not Path("/collision").exists()


def test_messages_of_logs_are_printable(caplog: pytest.LogCaptureFixture) -> None:
    logging.getLogger("cophy").warning("%s is skipped", "a\x1b[2J\ud800\n")
    assert caplog.messages == ["a\\x1b[2J\\ud800\n is skipped"]


def test_logs_of_other_packages_stay_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    record = logging.getLogRecordFactory()("other", logging.WARNING, "file.py", 1, "%d", ("a",), None)
    assert (record.msg, record.args) == ("%d", ("a",))  # logging itself reports it, and raises nothing


def test_a_full_disk_does_not_disturb_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    handler = LogFile(str(tmp_path / "run.log"))
    handler.stream = SimpleNamespace(write=raising(errno.ENOSPC))  # type: ignore[assignment]
    handler.handle(logging.makeLogRecord({"msg": "lost"}))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("module", "number"), [("tensorboard.writer", 0), ("other", 1)])
def test_an_error_of_tensorboards_thread_is_left_to_the_run(
    module: str, number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    thread = type("Writer", (threading.Thread,), {"__module__": module})()
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    print_error_of_thread(threading.ExceptHookArgs((OSError, error, None, thread)))
    assert capsys.readouterr().err.count("No space left") == number


def test_output_replaces_what_a_terminal_cannot_show() -> None:
    program = "import cophy.cli; print('3 \u2192 4 m\u00b2')"
    result = python("-c", program, env={"PYTHONIOENCODING": "ascii"})
    assert (result.stdout, result.stderr) == ("3 ? 4 m?\n", "")


def test_a_pipe_that_is_closed_ends_a_command_without_a_traceback() -> None:
    """As `--help | head`."""
    command = [sys.executable, str(ROOT / "src" / "predict.py"), "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == ""
    assert process.returncode == 128 + signal.SIGPIPE


def test_a_split_of_another_scenario_is_refused_before_slow_imports() -> None:
    code = (
        "import runpy, sys\n"
        "sys.argv = ['src/train.py', 'scenario=balls', 'split=all']\n"
        "try: runpy.run_path('src/train.py', run_name='__main__')\n"
        "finally: print({'lightning', 'pandas', 'matplotlib'} & sys.modules.keys())\n"
    )
    result = python("-c", code, cwd=ROOT, code=1)
    assert "split=all does not go with balls" in result.stderr
    assert result.stdout.strip() == "set()"


def test_look_without_a_scenario_asks_for_it(tmp_path: Path) -> None:
    printed = run("look", f"data_dir={tmp_path / 'data'}", f"directory={tmp_path / 'look'}", code=1)
    (line,) = printed.strip().splitlines()
    assert line.endswith("look.py: scenario= is not given: choose among blocktower, balls, collision")
    assert not list(tmp_path.iterdir())


def test_an_export_names_the_command_that_makes_its_data(tmp_path: Path, tiny_data: Path) -> None:
    words = ("scenario=collision", "size=tiny", f"root={tmp_path / 'tree'}")
    for keys, command in ((("images=false",), "data_seed=0"), ((), "'render.modalities=[rgb,segmentation]'")):
        printed = run("export", *words, *keys, f"data_dir={tmp_path / 'data'}", code=1)
        (line,) = printed.strip().splitlines()
        assert "is not finished: run `python src/generate.py scenario=collision size=tiny" in line
        assert command in line
    assert not (tmp_path / "data").exists()
    run("export", *words, "images=false", f"data_dir={tiny_data}")
    assert (tmp_path / "tree" / "collisionCF").is_dir()
