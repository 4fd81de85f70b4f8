"""Files that are written whole or not at all, and named if the disk is full."""

import errno
import glob
import hashlib
import io
import json
import os
import shutil
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4
from zipfile import ZipFile

import numpy as np

MACHINE = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
ABANDONED_S = 86400  # ours: a temporary file of another machine is abandoned after a day without a write
MAX_BYTES = 64 << 20  # ours: the largest file that is read whole is below 10 MiB
MAX_ARRAY_BYTES = 1 << 30  # ours: of a .npz file; the positions of the paper's largest test split have 0.05 GiB
FULL = 1 << 20  # bytes; ours: with less free space, files count as not written


def check_space(path: Path) -> None:
    """Raise OSError if the disk is full: OpenCV may truncate a file without an error."""
    if shutil.disk_usage(path.parent).free < FULL:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def read_plain(path: Path) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: It does not exist, is not a regular file (opening a pipe would block forever), or is too large.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if path.stat().st_size > MAX_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return path.read_bytes()


def read_json(path: Path) -> dict[str, Any]:
    """Return the dictionary in a JSON file.

    Raises:
        OSError: See `read_plain`.
        ValueError: The file holds something else.
    """
    try:
        content = json.loads(read_plain(path))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(content, dict):
        raise ValueError("it holds no dictionary")
    return content


def read_npz(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return arrays of a .npz file, all required ones and those of the optional ones that it has; pickles are refused.

    Raises:
        OSError: The operating system refuses access: nothing is known about the file.
        ValueError: It does not exist, is something else or too large, or lacks a required array.
    """
    try:
        if path.exists() and not path.is_file():
            raise ValueError("it is not a regular file")  # opening a pipe would block forever
        with path.open("rb") as stream, ZipFile(stream) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_ARRAY_BYTES:
                raise ValueError(f"more than {MAX_ARRAY_BYTES} bytes of arrays")
            stored = {member.removesuffix(".npy") for member in archive.namelist()}
            if missing := [name for name in required if name not in stored]:
                raise ValueError(f"it has no array {', '.join(missing)}; it has {', '.join(sorted(stored)) or 'none'}")
            return {
                name: np.lib.format.read_array(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)
                for name in (*required, *(name for name in optional if name in stored))
            }
    except Exception as error:  # zipfile, zlib and NumPy raise errors of many types
        if isinstance(error, OSError) and error.errno not in (None, errno.ENOENT):
            raise
        raise ValueError(" ".join(str(error).split())) from error


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    with appearing_whole(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def appearing_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it is flushed and renamed at the end, or removed after an error.

    The temporary name is unique, so that processes on any machines can write the same file. It contains the process that
    writes it, see `is_abandoned`; what killed processes left of the same file is removed first.

    Raises:
        OSError: It cannot be written or the disk is full; the error names `path`.
    """
    digits = "[0-9a-f]" * 8
    _remove_abandoned(path.parent, f"{glob.escape(path.name)}.{digits}-*-{digits}.tmp*")  # and SQLite's .tmp-wal
    temporary = path.with_name(f"{path.name}.{MACHINE}-{os.getpid()}-{uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        check_space(temporary)
        os.replace(temporary, path)
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


def _remove_abandoned(directory: Path, pattern: str = "*.tmp*") -> None:
    for temporary in directory.glob(pattern):
        if is_abandoned(temporary):
            temporary.unlink(missing_ok=True)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()
