"""Files that are written whole or not at all."""

import os
import shutil
from pathlib import Path

import pytest

from cophy.atomic_files import ABANDONED_S, MACHINE, appearing_whole, is_abandoned
from tests.commands import python


def test_a_temporary_file_is_abandoned_when_its_process_has_ended(tmp_path: Path) -> None:
    with appearing_whole(tmp_path / "shard.v2.h5") as temporary:
        temporary.write_bytes(b"half")
        assert not is_abandoned(temporary)
    killed = "from pathlib import Path; import os, sys; from cophy.atomic_files import appearing_whole\n"
    killed += "with appearing_whole(Path(sys.argv[1])) as path: path.write_bytes(b'half'); os._exit(9)"
    python("-c", killed, tmp_path / "shard.h5", code=9)
    (temporary,) = tmp_path.glob("shard.h5.*.tmp")
    assert is_abandoned(temporary)
    shutil.copy(temporary, tmp_path / f"{temporary.name}-wal")
    (tmp_path / "shard.h5.draft.tmp").touch()  # of somebody else
    with appearing_whole(tmp_path / "shard.h5") as second:
        second.write_bytes(b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"shard.h5", "shard.v2.h5", "shard.h5.draft.tmp"}


def test_a_temporary_file_of_another_machine_is_abandoned_after_a_day(tmp_path: Path) -> None:
    path = tmp_path / f"shard.h5.{'0' * len(MACHINE)}-1-a.tmp"
    path.write_bytes(b"half")
    assert not is_abandoned(path)
    os.utime(path, (0, path.stat().st_mtime - ABANDONED_S - 1))
    assert is_abandoned(path)


@pytest.mark.parametrize("name", ["shard.h5.half.tmp", "shard.h5.a-b.tmp", f"shard.h5.{MACHINE}-x-a.tmp", ".tmp"])
def test_a_temporary_file_without_the_name_of_a_process_is_abandoned(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    assert is_abandoned(tmp_path / name)


def test_a_full_disk_is_named_although_the_writer_reports_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1, 1, 0))
    with pytest.raises(OSError, match="No space left") as raised, appearing_whole(tmp_path / "clip.mp4") as temporary:
        temporary.write_bytes(b"half")
    assert raised.value.filename == str(tmp_path / "clip.mp4")
    assert not list(tmp_path.iterdir())
