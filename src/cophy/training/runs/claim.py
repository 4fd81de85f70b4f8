"""One process at a time makes a run; no run replaces the results of another, and none forgets its own before it begins."""

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from filelock import FileLock, Timeout

from cophy.errors import SAFE, CophyError
from cophy.training.runs.devices import is_first
from cophy.training.runs.identity import FAILURE, METRICS, Run
from cophy.training.runs.results import forget_results, write_failure


class Claim:
    """Of a run's directory, by one process.

    Attributes:
        run: Whose directory it is.
        has_begun: Whether the run got so far that it trains, tests or asks its oracle.
    """

    def __init__(self, run: Run) -> None:
        self.run, self.has_begun = run, False

    def begin(self, *, tests_checkpoint: bool) -> None:
        """Forget earlier results of the run. What is refused before, by a wrong key or missing data, costs none.

        Args:
            tests_checkpoint: Whether it tests a given checkpoint (predictor=). Then the results of a training are left alone.

        Raises:
            CophyError: There are such results.
        """
        if is_first() and tests_checkpoint and _is_of_training(self.run):
            raise CophyError(
                f"{self.run.directory / METRICS} is of a training with these settings: keep the results of predictor= "
                "elsewhere (source.outputs=), or remove it"
            )
        self.has_begun = True
        if is_first():
            forget_results(self.run)


@contextmanager
def claimed(run: Run) -> Iterator[Claim]:
    """The run's directory is this process's, and a failure is noted.

    Raises:
        CophyError: Another process is making this run, or the directory holds the results of another run.
    """
    claim = Claim(run)
    if not is_first():  # the first process claims it for all
        yield claim
        return
    run.directory.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(run.directory / ".lock", timeout=0).acquire()
    except Timeout as error:
        raise CophyError(f"{run.directory}: another process is making this run; wait until it is done") from error
    with lock:
        _check_own(run)
        (run.directory / FAILURE).unlink(missing_ok=True)
        try:
            yield claim
        except Exception as error:
            with suppress(OSError):  # of a full disk
                write_failure(run, error, has_begun=claim.has_begun)
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                raise CophyError(f"no space left for {run.directory}: {SAFE}") from error
            raise


def _is_of_training(run: Run) -> bool:
    try:
        return json.loads((run.directory / METRICS).read_bytes()).get("predictor") is None
    except (FileNotFoundError, ValueError, AttributeError):
        return False


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
