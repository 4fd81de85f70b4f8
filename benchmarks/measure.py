"""Ratios of CPU times, measured in pairs within one run, because other users of a machine slow both of a pair alike."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
REPEATS = 5
NUM_OBJECTS = {"blocktower": 3, "balls": 4, "collision": 2}


@dataclass(frozen=True)
class Measured:
    """A ratio, once per pair of runs. `reach` is the goal, for example "≤ 1.2", or empty."""

    what: str
    unit: str
    ratios: list[float]
    reach: str = ""

    @property
    def median(self) -> float:
        """Median of all pairs, the number that is reported."""
        return statistics.median(self.ratios)


def cpu_seconds(run: Callable[[], object]) -> float:
    """Measure the CPU time of this process in one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def paired(first: Callable[[], object], second: Callable[[], object]) -> list[float]:
    """Measure the CPU time of `first` ÷ that of `second`, REPEATS times in turn, after one of each that does not count."""
    first(), second()
    return [cpu_seconds(first) / cpu_seconds(second) for _ in range(REPEATS)]
