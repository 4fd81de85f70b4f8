"""Killed commands, full disks and commands at the same time: the same command continues to the same bytes and metrics."""

import os
import random
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from signal import SIGKILL, SIGTERM

import pytest

from tests.attacks.conftest import DATA, STEPS, TRAINING, Step, contents, copy_world

pytestmark = pytest.mark.slow

NAMES = [step.name for step in STEPS]
DISK_BYTES = 200 * 2**20
PAGE_BYTES = 2**12


@pytest.mark.parametrize("name", ["render", "derenderer", "train", "export"])
def test_a_killed_command_continues_to_the_same_result(name: str, worlds: list[Path], tmp_path: Path) -> None:
    number = NAMES.index(name)
    step, rng, log = STEPS[number], random.Random(number), tmp_path / "log"
    world, start = copy_world(worlds[number], tmp_path / "world"), time.monotonic()
    step.finish(world, log)
    seconds, expected = time.monotonic() - start, contents(world)
    copy_world(worlds[number], world)
    for send, signal in (*[(os.killpg, SIGKILL)] * 3, (os.kill, SIGTERM)):
        with step.started(world, log) as process:
            time.sleep(seconds * rng.uniform(0.2, 0.9))
            if process.poll() is None:
                send(process.pid, signal)
                process.wait(timeout=60)
        assert signal == SIGKILL or "Traceback" not in log.read_text(), log.read_text()[-3000:]
    step.finish(world, log)
    assert contents(world) == expected


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small file system in memory."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "cophy", str(disk)]
    if subprocess.run(command, capture_output=True).returncode != 0:
        pytest.skip("no file system can be mounted here")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


def resize(disk: Path, size: int) -> None:
    subprocess.run(["mount", "-o", f"remount,size={size}", str(disk)], check=True)


@pytest.mark.parametrize("name", ["generate", "derender", "train", "report"])
def test_a_full_disk_is_named_and_destroys_nothing(name: str, worlds: list[Path], disk: Path) -> None:
    number = NAMES.index(name)
    step, rng, log = STEPS[number], random.Random(number), disk.parent / "log"
    world = copy_world(worlds[number], disk / "world")
    before = shutil.disk_usage(disk).used
    step.finish(world, log)
    expected, needed = contents(world), shutil.disk_usage(disk).used - before
    copy_world(worlds[number], world)
    free = rng.randrange(0, needed, PAGE_BYTES)
    resize(disk, max(shutil.disk_usage(disk).used + free, PAGE_BYTES))
    with step.started(world, log) as process:
        code = process.wait(timeout=600)
    text = log.read_text()
    assert "Traceback" not in text, text[-3000:]
    assert code == 0 or "no space left" in text.lower(), text[-3000:]
    assert not list(world.rglob("*.tmp"))
    resize(disk, DISK_BYTES)
    step.finish(world, log)
    assert contents(world) == expected


def test_commands_at_the_same_time_end_as_one_after_another(worlds: list[Path], tmp_path: Path) -> None:
    steps = (
        *(step for step in STEPS if step.name in {"generate", "render", "train"}),
        Step("export", "export", (*DATA, "root={world}/tree", "images=false")),
        Step("in", "train", (*DATA, *TRAINING, "model=in", "trainer.max_epochs=2")),
        Step("copy", "train", (*DATA, *TRAINING, "model=copy_b")),
        Step("audit", "audit", (*DATA, "replayed_pairs=1", "directory={world}/audit")),
    )
    world, log = copy_world(worlds[1], tmp_path / "world"), tmp_path / "log"
    for step in steps:
        step.finish(world, log)
    expected = contents(world)
    copy_world(worlds[1], world)
    logs = [tmp_path / f"{step.name}.log" for step in steps]
    with ExitStack() as stack:
        processes = [stack.enter_context(step.started(world, log)) for step, log in zip(steps, logs, strict=True)]
        codes = [process.wait(timeout=600) for process in processes]
    assert codes == [0] * len(steps), [log.read_text()[-1000:] for log in logs]
    assert "Traceback" not in "".join(log.read_text() for log in logs)
    assert contents(world) == expected
