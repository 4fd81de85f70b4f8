"""Generate a dataset with worker processes: resumable, and the same bytes however it is run."""

import errno
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from filelock import FileLock
from tqdm import tqdm

from cophy.dataset.shard import DamagedShardError, encode, to_arrays
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store import (
    MANIFEST,
    is_finished,
    read_checksums,
    read_shard,
    shard_path,
    write_atomically,
    write_manifest,
)
from cophy.errors import CophyError
from cophy.scenario import Experiment, Simulator

log = logging.getLogger(__name__)
_done: "Synchronized[int]"  # experiments generated so far, shared by the workers of one run


@dataclass(frozen=True)
class ShardCost:
    """What a shard took."""

    simulations: int
    cpu_seconds: float


def ensure(spec: DatasetSpec, *, data_dir: Path, workers: int) -> Path:
    """The directory of a finished dataset, generated first where it is missing."""
    directory = spec.directory(data_dir)
    return directory if is_finished(directory, spec) else generate(spec, data_dir=data_dir, workers=workers)


def generate(spec: DatasetSpec, *, data_dir: Path, workers: int) -> Path:
    """Make what is missing or damaged of a dataset; several processes may ask for it at once, one works."""
    if multiprocessing.parent_process() is not None:  # a worker imports the script that started it
        raise CophyError("put what your script runs under `if __name__ == '__main__':`, generation starts processes")
    directory = spec.directory(data_dir)
    with _explain_full_disk(directory, spec), _locked(directory):
        for leftover in directory.glob("*.tmp"):
            leftover.unlink()
        missing = _missing_shards(directory, spec)
        if missing:
            _generate_shards(missing, directory, spec, workers)
        if missing or not (directory / MANIFEST).exists():
            write_manifest(directory, spec)
    log.info("%s: %d experiments, %d shards, all whole", directory, spec.num_experiments, spec.num_shards)
    return directory


def _missing_shards(directory: Path, spec: DatasetSpec) -> list[int]:
    checksums = read_checksums(directory, spec) or {}
    missing = []
    for shard in range(spec.num_shards):
        path = shard_path(directory, shard)
        if path.exists():
            try:
                read_shard(directory, shard, spec, checksums.get(path.name))
                continue
            except DamagedShardError as error:
                log.warning("%s is damaged (%s): making it again", path, error)
        missing.append(shard)
    return missing


def _generate_shards(shards: list[int], directory: Path, spec: DatasetSpec, workers: int) -> None:
    total = sum(len(spec.experiments_of_shard(shard)) for shard in shards)
    context = multiprocessing.get_context("spawn")
    done = context.Value("q", 0)
    start, costs = time.monotonic(), []
    with (
        _progress_bar(spec, total) as advance_to,
        ProcessPoolExecutor(min(workers, len(shards)), context, _start_worker, (done,)) as pool,
    ):
        pending = {pool.submit(_generate_shard, shard, directory, spec) for shard in shards}
        try:
            while pending:
                finished, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                costs += [future.result() for future in finished]
                advance_to(done.value)
        except BrokenProcessPool as error:
            raise CophyError(
                "a worker process was killed (out of memory?): finished shards are kept, run again with fewer workers="
            ) from error
        except BaseException:
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise
    log.info(
        "%d experiments in %.0f s: %.2f simulations and %.3f CPU-s per experiment",
        *(total, time.monotonic() - start),
        *(sum(cost.simulations for cost in costs) / total, sum(cost.cpu_seconds for cost in costs) / total),
    )


def _generate_shard(shard: int, directory: Path, spec: DatasetSpec) -> ShardCost:
    """Generate one shard in a worker."""
    start = time.process_time()
    experiments: list[Experiment] = []
    with Simulator() as simulator:
        for first in spec.experiments_of_shard(shard)[::2]:
            experiments += spec.scenario.twin_pair(
                spec.num_objects, seed=spec.seed, pair=first // 2, simulator=simulator
            )
            with _done.get_lock():
                _done.value += 2
        simulations = simulator.num_simulations
    write_atomically(shard_path(directory, shard), encode(to_arrays(experiments, shard, spec)))
    return ShardCost(simulations, time.process_time() - start)


def _start_worker(done: "Synchronized[int]") -> None:
    """Leave Ctrl-C to the parent, and end with it even when it is killed."""
    global _done
    _done = done
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def _progress_bar(spec: DatasetSpec, total: int) -> Iterator[Callable[[int], None]]:
    seconds = 0.5 if sys.stderr.isatty() else 20.0  # between updates: a log wants fewer lines
    title = f"{spec.scenario.name}, {spec.num_objects} objects"
    with tqdm(total=total, unit="exp", desc=title, mininterval=seconds, smoothing=0.1) as bar:

        def advance_to(count: int) -> None:
            bar.update(count - bar.n)

        yield advance_to


@contextmanager
def _locked(directory: Path) -> Iterator[None]:
    """One process at a time works on a dataset."""
    directory.mkdir(parents=True, exist_ok=True)
    with FileLock(directory / ".lock"):
        yield


@contextmanager
def _explain_full_disk(directory: Path, spec: DatasetSpec) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        whole = sum(shard_path(directory, shard).exists() for shard in range(spec.num_shards))
        raise CophyError(
            f"no space left for {directory} ({whole} of {spec.num_shards} shards are done and safe): "
            f"free some, or move with data_dir=, and run the same command again"
        ) from error
