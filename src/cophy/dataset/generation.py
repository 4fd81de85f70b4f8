"""Generate sets of shards with worker processes: resumable, and with the same bytes however it is run."""

import errno
import logging
import multiprocessing
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import ExitStack, contextmanager
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

from tqdm import tqdm

from cophy.atomic_files import appearing_whole, without_leftovers
from cophy.dataset.archive import Files, copy_shards, files_in_package
from cophy.dataset.shards import MANIFEST, DamagedShardError, ShardSet
from cophy.errors import CophyError
from cophy.locks import NoLocksError, locked
from cophy.workers import worker_pool

PATIENCE_S = 30  # until a warning that there is no first experiment yet
LONG_S = 30  # CPU-seconds from which an estimate is printed first
log = logging.getLogger(__name__)
_num_completed: "Synchronized[int]"  # experiments completed so far, shared by the workers of one run


def ensure(shards: ShardSet, *, workers: int) -> None:
    """Generate a set that is not finished."""
    if not shards.is_finished():
        make(shards, workers=workers)


def make(shards: ShardSet, *, workers: int, files: Files | None = None) -> None:
    """Generate missing and damaged shards, or copy them; if several processes call this at once, one of them works.

    Args:
        files: Where it is copied from; by default from the package if it is there, otherwise it is generated.
    """
    files = files or files_in_package(shards)
    every = range(shards.spec.num_shards)
    with _locked_if_writable(shards.directory) as writable, without_leftovers(shards.directory):
        if writable:
            _complete(shards, every, workers, files)
        elif not shards.is_finished() or _missing(shards, every):
            raise CophyError(
                f"{shards.directory} is incomplete and cannot be written to: make it writable, or choose another directory with data_dir="
            )
        else:
            _log_complete(shards)


def make_part(shards: ShardSet, part: int, parts: int, *, workers: int) -> None:
    """Generate every `parts`-th shard, starting at `part`; the process that finishes the last shard writes the manifest.

    For many processes, on any machines, with one file system. Nothing is locked: files appear whole, and have the same bytes
    whoever writes them. A single part is generated as by `make`.
    """
    if parts == 1:
        make(shards, workers=workers)
        return
    shards.directory.mkdir(parents=True, exist_ok=True)
    if not _complete(shards, range(part, shards.spec.num_shards, parts), workers, files_in_package(shards)):
        log.info("%s: part %d of %d is complete, others are not", shards.directory, part, parts)


def _complete(shards: ShardSet, wanted: Sequence[int], workers: int, files: Files | None) -> bool:
    """Make missing shards among those wanted. If the set is then complete, write its manifest and return True."""
    every, versions = range(shards.spec.num_shards), None
    if missing := _missing(shards, wanted):
        for shard, damage in missing.items():
            if damage is not None:
                log.warning("%s is damaged (%s): it is made again", shards.path(shard), damage)
        if files is None:
            _generate(list(missing), shards, workers)
        else:
            versions = copy_shards(list(missing), shards, files)
    if wanted != every and (not all(path.exists() for path in shards.paths()) or _missing(shards, every)):
        return False
    if missing or not (shards.directory / MANIFEST).exists():
        shards.write_manifest(versions)
    _log_complete(shards)
    return True


def _log_complete(shards: ShardSet) -> None:
    spec = shards.spec
    log.info("%s: all %d experiments in %d shards", shards.directory, spec.num_experiments, spec.num_shards)


def _missing(shards: ShardSet, wanted: Iterable[int]) -> dict[int, DamagedShardError | None]:
    """Return those of the wanted shards that do not exist (None) or are damaged."""
    checksums = shards.checksums() or {}
    missing: dict[int, DamagedShardError | None] = {}
    for shard in wanted:
        path = shards.path(shard)
        try:
            if path.exists():
                shards.verify(shard, checksums.get(path.name))
            else:
                missing[shard] = None
        except DamagedShardError as error:
            missing[shard] = error
    return missing


def _generate(missing: list[int], shards: ShardSet, workers: int) -> None:
    done, total = (
        multiprocessing.get_context("spawn").Value("q", 0),
        sum(len(shards.experiments(shard)) for shard in missing),
    )
    seconds, megabytes = shards.cost(total)
    if seconds > LONG_S:
        disk = f" and {megabytes:.0f} MB of disk" if megabytes else ""
        message = "%s: %d experiments take about %.0f CPU-minutes%s; Ctrl-C keeps finished files (workers=%d)"
        log.warning(message, shards.title, total, seconds / 60, disk, workers)
    start, is_warned, costs = time.monotonic(), False, defaultdict[str, float](float)
    with (
        progress_bar(shards.title, total) as bar,
        worker_pool(min(workers, len(missing)), _init_worker, done) as pool,
    ):
        pending = {pool.submit(_generate_shard, shard, shards) for shard in missing}
        while pending:
            finished, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in finished:
                for unit, cost in future.result().items():
                    costs[unit] += cost
            bar.update(done.value - bar.n)
            if not (is_warned or done.value) and time.monotonic() - start > PATIENCE_S:
                is_warned = True
                log.warning("%s: no experiment after %d s%s", shards.title, PATIENCE_S, shards.slow_hint)
    each = ", ".join(f"{cost / max(total, 1):.3g} {unit}" for unit, cost in costs.items())
    log.info("%d experiments in %.0f s; per experiment %s", total, time.monotonic() - start, each)


def _generate_shard(shard: int, shards: ShardSet) -> dict[str, float]:
    """Generate one shard in a worker; return its cost by unit."""

    def advance(experiments: int) -> None:
        with _num_completed.get_lock():
            _num_completed.value += experiments

    start = time.process_time()
    with appearing_whole(shards.path(shard)) as path:
        costs = shards.write(path, shard, advance)
    return {**costs, "CPU-s": time.process_time() - start}


def _init_worker(done: "Synchronized[int]") -> None:
    global _num_completed
    _num_completed = done


def progress_bar(title: str, total: int) -> "tqdm[Any]":
    """Return a progress bar of experiments."""
    seconds = 0.5 if sys.stderr.isatty() else 20.0  # between updates: fewer lines in a log
    return tqdm(total=total, unit="exp", desc=title, mininterval=seconds, smoothing=0.1)


@contextmanager
def _locked_if_writable(directory: Path) -> Iterator[bool]:
    """Lock a dataset's directory; yield False if it cannot be written to.

    On file systems without locks nothing is locked: two processes may then write the same shards, which appear whole.
    """
    directory.mkdir(parents=True, exist_ok=True)
    writable = True
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(directory / ".lock", elsewhere="data_dir="))
        except NoLocksError:
            pass
        except OSError as error:
            if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
                raise
            writable = False
        yield writable
