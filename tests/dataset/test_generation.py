"""Resume, repair, and the same bytes however a dataset is generated."""

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest
from filelock import FileLock

from cophy.atomic_files import appearing_whole
from cophy.dataset import generation
from cophy.dataset.shards import MANIFEST
from cophy.dataset.spec import FORMAT_VERSION
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.conftest import ROOT
from tests.dataset.copies import SPEC, copy, digests, generate


def test_one_and_two_workers_write_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    assert digests(generate(tmp_path, workers=1)) == digests(finished)


def test_generating_again_changes_nothing(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in directory.iterdir()}
    generate(tmp_path, workers=2)
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_a_killed_generation_continues_to_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    command = [
        sys.executable,
        str(ROOT / "src" / "generate.py"),
        "scenario=collision",
        "size=tiny",
        f"data_dir={tmp_path}",
    ]
    process = subprocess.Popen([*command, "workers=1"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    directory = SPEC.directory(tmp_path)
    while not States(SPEC, tmp_path).path(0).exists():
        assert process.poll() is None, "generation ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (directory / MANIFEST).exists()
    generate(tmp_path, workers=2)
    assert digests(directory) == digests(finished)
    assert not list(directory.glob("*.tmp"))


def test_processes_of_the_caller_outlive_a_failed_generation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    own.start()
    monkeypatch.setattr(generation, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path, workers=1)
    assert own.is_alive()
    own.terminate()
    own.join()


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_intact_shards_are_not_replaced_where_they_cannot_be_read(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()  # so that shards are opened, not only hashed

    def refuse(*args: object, **kwargs: object) -> None:
        raise OSError(errno.EAGAIN, "unable to lock file")

    monkeypatch.setattr(h5py, "File", refuse)
    before = {path.name: path.stat().st_mtime_ns for path in directory.glob("shard-*")}
    with pytest.raises(OSError, match="unable to lock"):
        generate(tmp_path, workers=1)
    assert {path.name: path.stat().st_mtime_ns for path in directory.glob("shard-*")} == before


def test_a_dataset_is_generated_on_a_file_system_without_locks(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: FileLock) -> None:
        raise NotImplementedError("FileSystem does not appear to support flock")

    monkeypatch.setattr(FileLock, "_acquire", refuse)
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    generate(tmp_path, workers=1)
    assert digests(directory) == digests(finished)


def test_a_truncated_shard_is_named_with_its_remedy_and_made_again(
    finished: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    directory = copy(finished, tmp_path)
    path = States(SPEC, tmp_path).path(1)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        CophyError, match=r"shard-00001\.h5 is damaged .* run `python src/generate\.py scenario=collision"
    ):
        States(SPEC, tmp_path).load()
    generate(tmp_path, workers=1)
    assert "shard-00001.h5 is damaged" in caplog.text
    assert digests(directory) == digests(finished)


def test_shards_that_changed_places_are_made_again(finished: Path, tmp_path: Path, caplog) -> None:
    """Without a manifest nothing else tells: both are whole."""
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    first, second = (States(SPEC, tmp_path).path(shard) for shard in (0, 1))
    kept = first.rename(first.with_suffix(".kept"))
    second.rename(first)
    kept.rename(second)
    generate(tmp_path, workers=1)
    assert f"it is shard {directory.name}/1, expected {directory.name}/0" in caplog.text
    assert digests(directory) == digests(finished)


def test_a_full_disk_is_said_in_one_line_and_loses_nothing(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object) -> None:
        (directory / "shard-00002.h5.half.tmp").write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    monkeypatch.setattr(States, "write_manifest", full)
    with pytest.raises(CophyError, match=r"no space left .*2 of 2 shards are done.*same command again"):
        generate(tmp_path, workers=1)
    assert not list(directory.glob("*.tmp"))


def test_what_a_part_writes_beside_is_left_to_it(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    with appearing_whole(directory / "shard-00000.h5") as temporary:
        temporary.write_bytes((directory / "shard-00000.h5").read_bytes())
        generate(tmp_path, workers=1)
        assert temporary.exists()
    assert digests(directory) == digests(finished)


@pytest.mark.parametrize("whole", [True, False])
def test_finished_data_that_cannot_be_written_to_are_only_checked(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog, whole: bool
) -> None:
    def refused(lock: FileLock) -> None:
        raise OSError(errno.EROFS, "Read-only file system", lock.lock_file)

    caplog.set_level("INFO")
    directory = copy(finished, tmp_path)
    monkeypatch.setattr(FileLock, "acquire", refused)
    if whole:
        generate(tmp_path, workers=1)
        assert "2 shards, all whole" in caplog.text
    else:
        (directory / MANIFEST).unlink()
        with pytest.raises(CophyError, match="cannot be written to"):
            generate(tmp_path, workers=1)


def test_a_pipe_in_the_place_of_a_shard_is_damage(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    path = States(SPEC, tmp_path).path(1)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(CophyError, match="it is no plain file"):
        States(SPEC, tmp_path).load()
    generate(tmp_path, workers=1)
    assert digests(directory) == digests(finished)


def test_a_dataset_of_another_format_is_named_with_its_remedy(finished: Path, tmp_path: Path, caplog) -> None:
    """Beside the one that is wanted; in the log of what makes it, and in the error of what only reads."""
    old = copy(finished, tmp_path)
    older = old.with_name(f"{old.name.rsplit('-', 1)[0]}-0badc0de")
    old.rename(older)
    text = (older / MANIFEST).read_text()
    (older / MANIFEST).write_text(text.replace(f'"format": {FORMAT_VERSION}', '"format": 2'))
    with pytest.raises(CophyError, match=r"not finished.*0badc0de is of format 2.*delete it, or use it with"):
        States(SPEC, tmp_path).load()
    generate(tmp_path, workers=2)
    assert "0badc0de is of format 2" in caplog.text
    assert (older / MANIFEST).exists()
