"""CPU-seconds from the command line to help, and to the end of a first training, validation and test step."""

import resource
import subprocess
import sys
import tempfile

from measure import REPEATS, ROOT, Measured


def measure() -> list[Measured]:
    """Measure seconds, not ratios: there is nothing to compare start-up with."""
    with tempfile.TemporaryDirectory() as directory:
        places = [f"data_dir={directory}/data", f"hydra.run.dir={directory}/run", "size=tiny"]
        cpu_seconds_of("generate.py", *places, "num_objects=[3]")
        first_step = [cpu_seconds_of("train.py", *places, "trainer.fast_dev_run=true") for _ in range(REPEATS)]
    return [
        Measured(
            "python src/train.py --help", "CPU-s", [cpu_seconds_of("train.py", "--help") for _ in range(REPEATS)], "≤ 3"
        ),
        Measured("first step of training, validation, test", "CPU-s", first_step, "≤ 10"),
    ]


def cpu_seconds_of(script: str, *arguments: str) -> float:
    """Measure the CPU time of a command and its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, f"src/{script}", *arguments], cwd=ROOT, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
