"""Locks between processes, and file systems without them."""

import errno
import fcntl
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from cophy.errors import CophyError
from cophy.locks import NoLocksError, locked
from tests.conftest import raising


def test_one_process_at_a_time_holds_a_lock(tmp_path: Path) -> None:
    def lock() -> AbstractContextManager[None]:
        return locked(tmp_path / ".lock", elsewhere="root=", busy="another process")

    for _ in range(2):  # it is released at the end
        with lock(), pytest.raises(CophyError, match="another process"), lock():
            pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_without_locks_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    monkeypatch.setattr(fcntl, "flock", raising(number))
    match = r"\.lock: the file system at /\S* cannot lock files \(.*\): choose a folder on another one with root="
    with pytest.raises(NoLocksError, match=match), locked(tmp_path / ".lock", elsewhere="root="):
        pass


def test_a_link_instead_of_a_lock_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / ".lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match=r"\.lock"), locked(tmp_path / ".lock", elsewhere="root="):
        pass
    assert not (tmp_path / "elsewhere").exists()
