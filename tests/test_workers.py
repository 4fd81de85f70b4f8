"""Pools of worker processes."""

import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest

from cophy.errors import CophyError
from cophy.workers import worker_pool
from tests.commands import python


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


SCRIPT = """
import sys
print("begins", __name__)
from cophy.workers import worker_pool
with worker_pool(2) as pool:
    print(list(pool.map(abs, [-1, -2])))
"""


@pytest.mark.parametrize("way", ["script", "-c", "standard input", "module"])
def test_workers_do_not_run_the_main_module_again(way: str, tmp_path: Path) -> None:
    """A script needs no guard, and standard input, which no process can import, works."""
    (tmp_path / "script.py").write_text(SCRIPT)
    words = {"script": ["script.py"], "-c": ["-c", SCRIPT], "standard input": ["-"], "module": ["-m", "script"]}[way]
    done = python(*words, cwd=tmp_path, env={"PYTHONPATH": os.pathsep.join(sys.path)}, input=SCRIPT)
    assert done.stdout == "begins __main__\n[1, 2]\n"
