"""Exclusive locks between processes, and the error of file systems that have none."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cophy.errors import CophyError


class NoLocksError(CophyError):
    """The file system cannot lock files, as Lustre without `-o flock`; the message names it and the remedy."""


@contextmanager
def locked(path: Path, *, elsewhere: str, busy: str | None = None) -> Iterator[None]:
    """Hold an exclusive lock on a file, which is created; links are not followed.

    Args:
        elsewhere: The key that chooses another folder, for the message of `NoLocksError`.
        busy: The message if another process holds the lock; None to wait for that process.

    Raises:
        CophyError: Another process holds the lock.
        NoLocksError: The file system has no locks.
        OSError: The file cannot be opened.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy else 0))
        except BlockingIOError as error:
            raise CophyError(busy) from error
        except OSError as error:
            mount = next(folder for folder in path.resolve().parents if folder.is_mount())
            raise NoLocksError(
                f"{path}: the file system at {mount} cannot lock files ({error.strerror}): choose a folder on another one "
                f"with {elsewhere}, or mount it with locks (Lustre: -o flock)"
            ) from error
        try:
            yield
        finally:
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # forked processes may have the descriptor, too
    finally:
        os.close(descriptor)
