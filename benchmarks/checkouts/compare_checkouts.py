"""CoPhyNet's training step here against that of another checkout: just bench training against=../cophy-before

A process for each checkout. They take turns, so that other users of the machine slow both alike.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from measure import ROOT, Measured
from speed_training import KINDS, Kind

PAIRS = 11
EXPERIMENTS_AT_ONCE = 256  # that a process trains on in its turn, at least one batch
GOALS = {32: "", 64: "≤ 1.25", 128: "", 512: ""}  # by batch size


def measure(there: Path) -> list[Measured]:
    """CPU time of steps here ÷ there, for every kind and batch size."""
    if not (there / "benchmarks" / "speed_training.py").is_file():
        sys.exit(f"against={there} is no checkout of this repository")
    with checkout_steps(ROOT) as ours, checkout_steps(there) as theirs:
        return [
            Measured(
                f"CoPhyNet, {name}, batch {size}", "CPU time here ÷ there", compared(ours, theirs, kind, size), goal
            )
            for name, kind in KINDS.items()
            for size, goal in GOALS.items()
        ]


@contextmanager
def checkout_steps(checkout: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process that answers how long steps of a checkout take (checkout_steps.py)."""
    command = [sys.executable, str(Path(__file__).with_name("checkout_steps.py")), str(checkout.resolve())]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=checkout, stdin=pipe, stdout=pipe, text=True, bufsize=1) as process:
        assert process.stdout is not None
        if not process.stdout.readline():
            sys.exit(f"{checkout}: its training step cannot be timed, see above")
        yield process


def compared(
    ours: "subprocess.Popen[str]", theirs: "subprocess.Popen[str]", kind: Kind, batch_size: int
) -> list[float]:
    """Ratios of CPU times, one of each pair of turns; the first pair warms up and does not count.

    Args:
        ours: The process of this checkout.
        theirs: The process of the other one.
        kind: Slots and objects of every experiment.
        batch_size: Experiments in a batch.

    Returns:
        PAIRS ratios, ours ÷ theirs.
    """
    steps = max(1, EXPERIMENTS_AT_ONCE // batch_size)
    question = f"{kind.slots} {kind.objects} {batch_size} {steps}\n"
    return [ask(ours, question) / ask(theirs, question) for _ in range(PAIRS + 1)][1:]


def ask(process: "subprocess.Popen[str]", question: str) -> float:
    """CPU-seconds."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(question)
    return float(process.stdout.readline())
