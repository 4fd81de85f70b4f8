"""Make a set of shards with worker processes: resumable, and the same bytes however it is run."""

import errno
import logging
import multiprocessing
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from filelock import FileLock
from tqdm import tqdm

from cophy.atomic_files import appearing_whole, check_space, without_leftovers
from cophy.dataset.shards import MANIFEST, DamagedShardError, ShardSet
from cophy.errors import CophyError
from cophy.workers import begin_worker, ending_workers

PATIENCE_S = 30  # until it is said that there is no first experiment yet
log = logging.getLogger(__name__)
GUARD = "`if __name__ == '__main__':`"
_done: "Synchronized[int]"  # experiments generated so far, shared by the workers of one run


def ensure(shards: ShardSet, *, workers: int) -> None:
    """Make what is not finished yet."""
    if not shards.is_finished():
        make(shards, workers=workers)


def make(shards: ShardSet, *, workers: int) -> None:
    """Make what is missing or damaged; several processes may ask for it at once, one works."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # a worker imports the script that started it
        raise CophyError(f"put what your script runs under {GUARD}, generation starts processes")
    with _explain_full_disk(shards), _locked(shards.directory) as writable, without_leftovers(shards.directory):
        missing = _missing(shards, range(shards.spec.num_shards))
        if not (writable or shards.is_finished()) or (missing and not writable):
            raise CophyError(
                f"{shards.directory} is not whole and cannot be written to: make it writable, or move with data_dir="
            )
        if missing:
            for remark in shards.remarks():
                log.warning(remark)
            _make(missing, shards, workers)
        if missing or not (shards.directory / MANIFEST).exists():
            shards.write_manifest()
    _say_whole(shards)


def make_part(shards: ShardSet, part: int, parts: int, *, workers: int) -> None:
    """Make every `parts`-th shard, from `part` on; who makes the last of all vouches for the set.

    For many processes, on whatever machines, over one file system. Nothing is locked: shards and manifest appear whole, and
    have the same bytes whoever makes them.

    Args:
        shards: The set.
        part: Which of the parts.
        parts: How many there are; the only part is made as `make` does.
        workers: Processes.
    """
    if parts == 1:
        make(shards, workers=workers)
        return
    every = range(shards.spec.num_shards)
    shards.directory.mkdir(parents=True, exist_ok=True)
    with _explain_full_disk(shards):
        if missing := _missing(shards, every[part::parts]):
            _make(missing, shards, workers)
        if not all(shards.path(shard).exists() for shard in every) or _missing(shards, every):
            log.info("%s: part %d of %d is whole, others are not yet", shards.directory, part, parts)
            return
        if missing or not (shards.directory / MANIFEST).exists():
            shards.write_manifest()
    _say_whole(shards)


def _say_whole(shards: ShardSet) -> None:
    spec = shards.spec
    log.info("%s: %d experiments, %d shards, all whole", shards.directory, spec.num_experiments, spec.num_shards)


def _missing(shards: ShardSet, wanted: Iterable[int]) -> list[int]:
    """Those of the wanted shards that are not there, or damaged."""
    checksums = shards.checksums() or {}
    missing = []
    for shard in wanted:
        path = shards.path(shard)
        if path.exists():
            try:
                shards.verify(shard, checksums.get(path.name))
                continue
            except DamagedShardError as error:
                log.warning("%s is damaged (%s): making it again", path, error)
        missing.append(shard)
    return missing


def _make(missing: list[int], shards: ShardSet, workers: int) -> None:
    total = sum(map(shards.num_made, missing))
    context = multiprocessing.get_context("spawn")
    if multiprocessing.get_start_method() not in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("spawn", force=True)  # a job of joblib: its "loky" is unknown to its children
    done = context.Value("q", 0)
    start, took, told = time.monotonic(), defaultdict[str, float](float), False
    with (
        progress_bar(shards.title, total) as advance_to,
        ProcessPoolExecutor(min(workers, len(missing)), context, _start_worker, (done,)) as pool,
        ending_workers(),
    ):
        pending = {pool.submit(_make_shard, shard, shards) for shard in missing}
        try:
            while pending:
                finished, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in finished:
                    for what, value in future.result().items():
                        took[what] += value
                advance_to(done.value)
                if not told and not done.value and time.monotonic() - start > PATIENCE_S:
                    told = True
                    log.warning("%s: none in %d s%s", shards.title, PATIENCE_S, shards.why_slow)
        except BrokenProcessPool as error:
            check_space(shards.directory / MANIFEST)  # HDF5 can end a process that cannot write
            unguarded = (
                "" if done.value else f"a script of your own has to begin with {GUARD}, which starts processes; else "
            )
            raise CophyError(
                f"{unguarded}a worker process was killed (out of memory?): finished shards are kept, run again with fewer workers="
            ) from error
    each = ", ".join(f"{value / max(total, 1):.3g} {what}" for what, value in took.items())
    log.info("%d experiments in %.0f s; per experiment %s", total, time.monotonic() - start, each)


def _make_shard(shard: int, shards: ShardSet) -> dict[str, float]:
    """Make one shard in a worker."""

    def advance(experiments: int) -> None:
        with _done.get_lock():
            _done.value += experiments

    start = time.process_time()
    with appearing_whole(shards.path(shard)) as path:
        took = shards.write(path, shard, advance)
    return {**took, "CPU-s": time.process_time() - start}


def _start_worker(done: "Synchronized[int]") -> None:
    global _done
    _done = done
    begin_worker()


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar of experiments; the function it gives moves it to a count."""
    seconds = 0.5 if sys.stderr.isatty() else 20.0  # between updates: a log wants fewer lines
    with tqdm(total=total, unit="exp", desc=title, mininterval=seconds, smoothing=0.1) as bar:

        def advance_to(count: int) -> None:
            bar.update(count - bar.n)

        yield advance_to


@contextmanager
def _locked(directory: Path) -> Iterator[bool]:
    """Lock a dataset's directory for one process; yields False where the directory cannot be written to.

    File systems without locks get none: two processes would then write the same shards, which appear whole.
    """
    directory.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(directory / ".lock").acquire()
    except NotImplementedError:  # of filelock: the file system has no locks
        yield True
        return
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        yield False
        return
    with lock:
        yield True


@contextmanager
def _explain_full_disk(shards: ShardSet) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        count = shards.spec.num_shards
        whole = sum(shards.path(shard).exists() for shard in range(count))
        raise CophyError(
            f"no space left for {shards.directory} ({whole} of {count} shards are done and safe): "
            f"free some, or move with data_dir=, and run the same command again"
        ) from error
