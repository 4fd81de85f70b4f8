"""One process at a time makes a run, and no run replaces the results of another."""

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from filelock import FileLock, Timeout

from cophy.errors import SAFE, CophyError
from cophy.training.runs.devices import is_first
from cophy.training.runs.identity import METRICS, Run
from cophy.training.runs.results import forget_results, write_failure


@contextmanager
def claimed(run: Run) -> Iterator[None]:
    """The run's directory is this process's: earlier results of the same run are forgotten, a failure is noted.

    Raises:
        CophyError: Another process is making this run, or the directory holds the results of another run.
    """
    if not is_first():  # the first process claims it for all
        yield
        return
    run.directory.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(run.directory / ".lock", timeout=0).acquire()
    except Timeout as error:
        raise CophyError(f"{run.directory}: another process is making this run; wait until it is done") from error
    with lock:
        _check_own(run)
        forget_results(run)
        try:
            yield
        except Exception as error:
            with suppress(OSError):  # of a full disk
                write_failure(run, error)
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                raise CophyError(f"no space left for {run.directory}: {SAFE}") from error
            raise


def _check_own(run: Run) -> None:
    path = run.directory / METRICS
    try:
        content = {"variant": "", **json.loads(path.read_bytes())}  # earlier versions did not write it
        others = {key: content[key] for key, value in run.names().items() if content[key] != value}
    except FileNotFoundError:
        return
    except (ValueError, KeyError, TypeError):
        others = {}  # it cannot be said whose: it is of no use to anybody
    if others:
        which = ", ".join(f"{key}={value}" for key, value in others.items())
        raise CophyError(f"{path} is of another run ({which}): choose another hydra.run.dir, or remove it")
