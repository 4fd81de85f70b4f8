"""Commands in processes of their own, as they are killed, starved of space, and run beside each other."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.attacks.world import Step
from tests.conftest import ROOT

LOST = {"Traceback", "Fatal Python error"}


@contextmanager
def started(step: Step, world: Path, said: Path) -> Iterator[subprocess.Popen]:
    """The command in processes of its own, of which none is left; what they say is written to `said`."""
    script, *words = step.command(world)
    command = [sys.executable, str(ROOT / "src" / f"{script}.py"), *words]
    with open(said, "w") as printed:
        process = subprocess.Popen(command, stdout=printed, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        yield process
    finally:
        end(process, signal.SIGKILL, everybody=True)
        process.wait()


def end(process: subprocess.Popen, how: signal.Signals, *, everybody: bool) -> None:
    with suppress(ProcessLookupError):  # it was done before
        (os.killpg if everybody else os.kill)(process.pid, how)


def finish(step: Step, world: Path, said: Path) -> float:
    """Run it to its end, and return the seconds that took."""
    began = time.monotonic()
    with started(step, world, said) as process:
        code = process.wait(timeout=600)
    text = said.read_text()
    assert code == 0, text[-3000:]
    assert not any(word in text for word in LOST), text[-3000:]
    return time.monotonic() - began
