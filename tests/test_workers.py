"""Pools of worker processes."""

import multiprocessing
import os
import time

import pytest

from cophy.errors import CophyError
from cophy.workers import worker_pool


def test_after_an_error_the_workers_end_and_other_processes_stay() -> None:
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    other.start()
    with pytest.raises(KeyboardInterrupt):
        sleep_and_interrupt()
    assert multiprocessing.active_children() == [other]
    other.terminate()
    other.join()


def sleep_and_interrupt() -> None:
    with worker_pool(1) as pool:
        pool.submit(time.sleep, 60)
        raise KeyboardInterrupt


def test_a_killed_worker_is_named_with_a_remedy() -> None:
    message = r"a worker process was killed.* Run again with fewer workers="
    with pytest.raises(CophyError, match=message), worker_pool(1) as pool:
        pool.submit(os._exit, 9).result()
