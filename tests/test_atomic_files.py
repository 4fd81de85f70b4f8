"""Temporary files: whose are left behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cophy.atomic_files import ABANDONED_S, MACHINE, appearing_whole, is_left_behind


def test_a_temporary_file_is_left_behind_when_its_writer_is_gone(tmp_path: Path) -> None:
    with appearing_whole(tmp_path / "shard.v2.h5") as temporary:
        temporary.write_bytes(b"half")
        assert not is_left_behind(temporary)
    killed = "from pathlib import Path; import os, sys; from cophy.atomic_files import appearing_whole\n"
    killed += "with appearing_whole(Path(sys.argv[1])) as path: path.write_bytes(b'half'); os._exit(9)"
    assert subprocess.run([sys.executable, "-c", killed, str(tmp_path / "shard.h5")], check=False).returncode == 9
    (left,) = tmp_path.glob("shard.h5.*.tmp")
    assert is_left_behind(left)


def test_what_another_machine_writes_to_is_left_behind_after_a_day(tmp_path: Path) -> None:
    path = tmp_path / f"shard.h5.{'0' * len(MACHINE)}-1-a.tmp"
    path.write_bytes(b"half")
    assert not is_left_behind(path)
    os.utime(path, (0, path.stat().st_mtime - ABANDONED_S - 1))
    assert is_left_behind(path)


@pytest.mark.parametrize("name", ["shard.h5.half.tmp", "shard.h5.a-b.tmp", f"shard.h5.{MACHINE}-x-a.tmp", ".tmp"])
def test_what_names_no_writer_is_left_behind(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    assert is_left_behind(tmp_path / name)
