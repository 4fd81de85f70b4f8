"""Where the disk is full, a command says so in one line; with more space it goes on to the same."""

import random
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.attacks.processes import finish, started
from tests.attacks.world import STEPS, contents, copied

SPARE = 200 * 2**20


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own in memory."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SPARE}", "cophy", str(place)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"a small file system cannot be mounted here: {mounted.stderr.decode().strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def resize(disk: Path, size: int) -> None:
    subprocess.run(["mount", "-o", f"remount,size={size}", str(disk)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(STEPS)), ids=[step.name for step in STEPS])
def test_a_full_disk_is_named_and_harms_nothing(number: int, worlds: list[Path], disk: Path, attacks: int) -> None:
    step, chance = STEPS[number], random.Random(number)
    world, said = copied(worlds[number], disk / "world"), disk.parent / "said.log"
    before = shutil.disk_usage(disk).used
    finish(step, world, said)
    expected, needed = contents(world), shutil.disk_usage(disk).used - before
    for _ in range(attacks):
        copied(worlds[number], world)
        page = 2**12
        resize(disk, max(shutil.disk_usage(disk).used + chance.randrange(0, needed, page) // page * page, page))
        with started(step, world, said) as process:
            code = process.wait(timeout=600)
        text = said.read_text()
        assert "Traceback" not in text, text[-3000:]
        assert code == 0 or "no space left" in text, text[-3000:]
        assert not list(world.rglob("*.tmp"))  # what would keep it full
        resize(disk, SPARE)
        finish(step, world, said)
        assert contents(world) == expected
