"""Pools of worker processes that end with the process that started them, and never run its script or notebook again."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

from cophy.errors import CophyError


class _Process(SpawnProcess):
    """A spawned process without the main module of its parent.

    What workers call is imported by name. The main module may be a script without `if __name__ == "__main__":`, or standard
    input, which no process can import.
    """

    @staticmethod
    def _Popen(process_obj: Any) -> Any:  # noqa: N802 (of multiprocessing)
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")  # has no file that multiprocessing would tell the child to run
        try:
            return SpawnProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = main


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def worker_pool(
    workers: int, initializer: Callable[..., None] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of spawned processes. If the work with it fails, they end at once; other child processes are left alone.

    Args:
        initializer: Called with `arguments` in each process.

    Raises:
        CophyError: A process was killed.
    """
    if multiprocessing.get_start_method(allow_none=True) not in (None, *multiprocessing.get_all_start_methods()):
        multiprocessing.set_start_method("spawn", force=True)  # a job of joblib: its "loky" is unknown to its children
    before, context = multiprocessing.active_children(), _Context()
    with ProcessPoolExecutor(workers, context, _start, (initializer, arguments)) as pool:
        try:
            yield pool
        except BaseException as error:
            for process in multiprocessing.active_children():
                if process not in before:
                    process.terminate()
            if isinstance(error, BrokenProcessPool):
                raise CophyError(
                    "a worker process was killed, possibly because the memory or the disk was full; finished files are kept. "
                    "Run again with fewer workers="
                ) from error
            raise


def _start(initializer: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """Leave Ctrl-C to the parent process, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    if initializer is not None:
        initializer(*arguments)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
