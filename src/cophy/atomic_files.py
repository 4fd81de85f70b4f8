"""Files that are there whole or not at all."""

import errno
import hashlib
import os
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

MACHINE = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
ABANDONED_S = 86400  # ours: what nobody wrote to for a day is taken to be left behind
FULL = 1 << 20  # bytes; ours: with less free space, a failed write counts as a full disk


def check_space(path: Path) -> None:
    """Raise OSError if the disk is full: HDF5 and OpenCV may truncate a file without an error."""
    if shutil.disk_usage(path.parent).free < FULL:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def read_plain(path: Path) -> bytes:
    """What a file holds.

    Raises:
        OSError: It is not there, or no plain file: to open a pipe would wait for ever.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    return path.read_bytes()


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with appearing_whole(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def appearing_whole(path: Path) -> Iterator[Path]:
    """A temporary name to write to; what was written is flushed and renamed at the end, or removed on failure.

    The name is nobody else's, so that two processes that write the same file, on whatever machines, do not meet. It tells
    who writes, see `is_left_behind`.

    Raises:
        OSError: It cannot be written; the error names the file that was to appear.
    """
    temporary = path.with_name(f"{path.name}.{MACHINE}-{os.getpid()}-{uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is not None and (error.filename is None or str(error.filename) == str(temporary)):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def is_left_behind(temporary: Path) -> bool:
    """Whether the process that wrote to this temporary name is gone. Of one that cannot be asked, its last write tells."""
    try:
        machine, process, _ = temporary.name.rpartition(".tmp")[0].rpartition(".")[2].split("-")
        if machine == MACHINE:
            os.kill(int(process), 0)  # sends nothing
        return time.time() - temporary.stat().st_mtime > ABANDONED_S
    except PermissionError:  # it runs, for somebody else
        return False
    except (ValueError, IndexError, OSError):  # no name of ours, or no such process; or the file itself is gone
        return True


@contextmanager
def without_leftovers(directory: Path) -> Iterator[None]:
    """Begin and end without half-written files: of a process that was killed, or of workers that a full disk ended.

    Those of processes that may be at work beside stay. Workers of what was killed may take a moment to end.
    """
    _remove_leftovers(directory)
    try:
        yield
    finally:
        _remove_leftovers(directory)


def _remove_leftovers(directory: Path) -> None:
    for temporary in directory.glob("*.tmp*"):
        if is_left_behind(temporary):
            temporary.unlink(missing_ok=True)


def sha256(path: Path) -> str:
    """Digest of a file."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
