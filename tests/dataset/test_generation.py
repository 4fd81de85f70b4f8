"""Generation: it resumes, repairs, and writes the same bytes however it is run."""

import errno
import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import pytest

from cophy.atomic_files import appearing_whole
from cophy.dataset import generation
from cophy.dataset.experiment_set import FRAMES
from cophy.dataset.images import Images
from cophy.dataset.shards import MANIFEST
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario.rendering import Backend, RenderSettings
from cophy.workers import worker_pool
from tests.commands import run, run_apart
from tests.conftest import ROOT, SCENARIOS, raising, settings, tiny_spec
from tests.dataset.copies import IMAGE_SPEC, SPEC, copy, digests, generate


def test_two_workers_write_the_same_bytes_as_one_process(few: Path, tmp_path: Path) -> None:
    directory = copy(few, tmp_path)
    for path in directory.glob("shard-*"):
        path.unlink()
    with mock.patch.object(generation, "worker_pool", worker_pool):
        generate(tmp_path, IMAGE_SPEC, workers=2)
    assert digests(directory) == digests(few)


def test_generating_again_changes_nothing(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in directory.iterdir()}
    generate(tmp_path)
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
    generate(tmp_path)
    assert digests(directory) == digests(finished)
    assert not list(directory.glob("*.tmp"))


def test_intact_shards_are_not_replaced_where_they_cannot_be_read(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()  # so that shards are opened, not only hashed

    monkeypatch.setattr(os, "pread", raising(errno.EIO))
    before = {path.name: path.stat().st_mtime_ns for path in directory.glob("shard-*")}
    with pytest.raises(OSError, match=r"Input/output error: .*shard-00000\.h5"):
        generate(tmp_path)
    assert {path.name: path.stat().st_mtime_ns for path in directory.glob("shard-*")} == before


def test_shards_without_permission_to_read_are_not_damaged(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = copy(finished, tmp_path)
    before = {path.name: path.stat().st_ino for path in directory.glob("shard-*")}
    with monkeypatch.context() as patched:
        patched.setattr("cophy.dataset.shards.sha256", raising(errno.EACCES))
        with pytest.raises(PermissionError):
            generate(tmp_path)
        with pytest.raises(PermissionError):
            States(SPEC, tmp_path).load()
    assert {path.name: path.stat().st_ino for path in directory.glob("shard-*")} == before
    assert digests(directory) == digests(finished)


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_dataset_is_generated_on_a_file_system_without_locks(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    monkeypatch.setattr(fcntl, "flock", raising(number))
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    generate(tmp_path)
    assert digests(directory) == digests(finished)


def test_a_truncated_shard_is_named_with_its_remedy_and_generated_again(
    few: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    directory = copy(few, tmp_path)
    path = States(IMAGE_SPEC, tmp_path).path(1)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        CophyError, match=r"shard-00001\.h5 is damaged .* run `python src/generate\.py scenario=collision"
    ):
        States(IMAGE_SPEC, tmp_path).load()
    generate(tmp_path, IMAGE_SPEC)
    assert "shard-00001.h5 is damaged" in caplog.text
    assert digests(directory) == digests(few)


def test_shards_that_changed_places_are_generated_again(few: Path, tmp_path: Path, caplog) -> None:
    """Both are intact, and there is no manifest."""
    directory = copy(few, tmp_path)
    (directory / MANIFEST).unlink()
    first, second = (States(IMAGE_SPEC, tmp_path).path(shard) for shard in (0, 1))
    kept = first.rename(first.with_suffix(".kept"))
    second.rename(first)
    kept.rename(second)
    generate(tmp_path, IMAGE_SPEC)
    assert f"its shard is {directory.name}/1, not {directory.name}/0" in caplog.text
    assert digests(directory) == digests(few)


def test_a_full_disk_is_named_and_loses_nothing(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: States, path: Path, *_: object) -> None:
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    directory = copy(finished, tmp_path)
    (directory / "shard-00001.h5").unlink()
    (directory / "shard-00002.h5.half.tmp").write_bytes(b"half")
    monkeypatch.setattr(States, "write", full)
    with pytest.raises(OSError, match=r"No space left .*shard-00001\.h5"):
        generate(tmp_path)
    assert sorted(path.name for path in directory.glob("*.h5*")) == ["shard-00000.h5"]


def test_the_temporary_file_of_another_process_is_kept(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    with appearing_whole(directory / "shard-00000.h5") as temporary:
        temporary.write_bytes((directory / "shard-00000.h5").read_bytes())
        generate(tmp_path)
        assert temporary.exists()
    assert digests(directory) == digests(finished)


@pytest.mark.parametrize("whole", [True, False])
def test_finished_data_that_cannot_be_written_to_are_only_checked(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog, whole: bool
) -> None:
    caplog.set_level("INFO")
    directory = copy(finished, tmp_path)
    monkeypatch.setattr(generation, "locked", raising(errno.EROFS))
    if whole:
        generate(tmp_path)
        assert "all 48 experiments in 2 shards" in caplog.text
    else:
        (directory / MANIFEST).unlink()
        with pytest.raises(CophyError, match="cannot be written to"):
            generate(tmp_path)


def test_a_pipe_instead_of_a_shard_is_damage(few: Path, tmp_path: Path) -> None:
    directory = copy(few, tmp_path)
    path = States(IMAGE_SPEC, tmp_path).path(1)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(CophyError, match="it is not a regular file"):
        States(IMAGE_SPEC, tmp_path).load()
    generate(tmp_path, IMAGE_SPEC)
    assert digests(directory) == digests(few)


def test_parts_have_the_bytes_of_the_whole(few: Path, tmp_path: Path) -> None:
    states = States(IMAGE_SPEC, tmp_path)
    generation.make_part(states, 1, 2, workers=1)
    assert [path.name for path in states.directory.glob("*.h5")] == ["shard-00001.h5"]
    assert not states.is_finished()
    generation.make_part(states, 0, 2, workers=1)
    assert digests(states.directory) == digests(few)


def test_a_part_repairs_only_its_own_shards(few: Path, tmp_path: Path) -> None:
    directory, states = copy(few, tmp_path), States(IMAGE_SPEC, tmp_path)
    (directory / MANIFEST).unlink()
    path = states.path(1)
    path.write_bytes(path.read_bytes()[:1000])
    generation.make_part(states, 0, 2, workers=1)
    assert not states.is_finished()  # the manifest is not written while a shard is damaged
    generation.make_part(states, 1, 2, workers=1)
    assert digests(directory) == digests(few)


@pytest.mark.slow
def test_parallel_jobs_generate_one_dataset(finished: Path, tmp_path: Path) -> None:
    keys = ("scenario=collision", "size=tiny", "part=0,1", "parts=2", "workers=1", f"data_dir={tmp_path}")
    printed = run_apart("generate", "-m", *keys, "hydra/launcher=local", "hydra.launcher.n_jobs=2")
    assert "all 48 experiments in 2 shards" in printed
    assert digests(SPEC.directory(tmp_path)) == digests(finished)


def test_a_part_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    printed = run("generate", "scenario=collision", "size=tiny", "part=2", "parts=2", f"data_dir={tmp_path}", code=1)
    assert "part=2 must be from 0 to 1" in printed


def test_long_work_prints_an_estimate_first(
    few: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    directory = copy(few, tmp_path)
    (directory / "shard-00001.h5").unlink()
    generate(tmp_path, IMAGE_SPEC)
    assert not caplog.messages
    for seconds, minutes in ((400, 40), (8, 1)):  # half a minute is long, where nothing else is printed
        (directory / "shard-00001.h5").unlink()
        monkeypatch.setattr(States, "cost", lambda self, count, each=seconds: (each * count, 0.5 * count))
        generate(tmp_path, IMAGE_SPEC)
        (message,) = caplog.messages
        assert f"6 experiments take about {minutes} CPU-minutes and 3 MB of disk" in message
        caplog.clear()


def test_every_dataset_has_a_measured_cost() -> None:
    for scenario in SCENARIOS:
        counts = settings("generate", f"scenario={scenario}", "size=paper").size.num_experiments[scenario]
        for count in map(int, counts):
            assert all(value > 0 for value in States(tiny_spec(scenario, count), Path()).cost(2))


def test_the_cost_of_images_follows_their_size_and_number() -> None:
    states = States(tiny_spec("balls"), Path())
    seconds, megabytes = Images(states, RenderSettings(["rgb"], 448, Backend.tiny)).cost(100)
    assert (seconds, megabytes) == pytest.approx((100 * 60 / 8, 160))
    smaller, _ = Images(states, RenderSettings(["rgb"], 300, Backend.tiny)).cost(100)
    assert 100 * 60 / 27 < smaller < seconds
    tested, _ = Images(states, RenderSettings(["rgb"], 448, Backend.tiny), FRAMES["test_inputs"]).cost(100)
    assert tested == pytest.approx(0.1 * 100 * 31 / 8)
