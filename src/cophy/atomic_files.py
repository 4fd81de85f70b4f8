"""Files that are written whole or not at all, and named if the disk is full."""

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
ABANDONED_S = 86400  # ours: a temporary file of another machine is abandoned after a day without a write
MAX_PLAIN = 64 << 20  # bytes; ours: manifests and lists have less than one megabyte
FULL = 1 << 20  # bytes; ours: with less free space, files count as not written


def check_space(path: Path) -> None:
    """Raise OSError if the disk is full: HDF5 and OpenCV may truncate a file without an error."""
    if shutil.disk_usage(path.parent).free < FULL:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def read_plain(path: Path) -> bytes:
    """Return the content of a small file.

    Raises:
        OSError: It does not exist, is larger than MAX_PLAIN or is not a regular file: opening a pipe would block forever.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if path.stat().st_size > MAX_PLAIN:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return path.read_bytes()


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with appearing_whole(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def appearing_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it is flushed and renamed at the end, or removed after an error.

    The temporary name is unique, so that processes on any machines can write the same file. It contains the process that
    writes it, see `is_abandoned`.

    Raises:
        OSError: It cannot be written or the disk is full; the error names `path`.
    """
    temporary = path.with_name(f"{path.name}.{MACHINE}-{os.getpid()}-{uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        check_space(temporary)
        os.replace(temporary, path)
    except RuntimeError as error:  # HDF5 has no other error for a full disk when it closes a file
        if f"errno = {errno.ENOSPC}," in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise
    except OSError as error:
        if error.errno is not None and (error.filename is None or str(error.filename) == str(temporary)):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def is_abandoned(temporary: Path) -> bool:
    """Return whether the process that writes a temporary file has ended; on another machine, judge by the last write."""
    try:
        machine, process, _ = temporary.name.rpartition(".tmp")[0].rpartition(".")[2].split("-")
        if machine == MACHINE:
            os.kill(int(process), 0)  # sends nothing
        return time.time() - temporary.stat().st_mtime > ABANDONED_S
    except PermissionError:  # the process of another user
        return False
    except (ValueError, OSError):  # a different name, no such process, or no such file
        return True


@contextmanager
def without_leftovers(directory: Path) -> Iterator[None]:
    """Remove abandoned temporary files before and after: those of killed processes, and of workers that a full disk ended."""
    try:
        _remove_abandoned(directory)
        yield
    finally:
        _remove_abandoned(directory)


def _remove_abandoned(directory: Path) -> None:
    for temporary in directory.glob("*.tmp*"):
        if is_abandoned(temporary):
            temporary.unlink(missing_ok=True)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()
