"""One line of an audit, and how far a share may be off."""

from dataclasses import dataclass

import numpy as np

BALANCE_TOLERANCE = 0.05  # paper Sec. 3: 50 ± 5 % of the counterfactual outcomes are stable

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Check:
    """What was looked at, what was found, and whether that is sound."""

    name: str
    found: str
    passed: bool


@dataclass(frozen=True)
class ClassifierCheck(Check):
    """What a classifier guesses: the share that is right, its bootstrap 95 % interval over twin pairs, and the share by chance."""

    accuracy: float
    low: float
    high: float
    chance: float


def by_chance(share: float, draws: int) -> float:
    """How far chance may take a share among `draws` independent draws: three standard deviations; everywhere without any draw."""
    return 3 * float(np.sqrt(share * (1 - share) / draws)) if draws else 1.0


def tolerance(share: float, draws: int) -> float:
    """BALANCE_TOLERANCE, or what chance may do where that is more (tiny sets)."""
    return max(BALANCE_TOLERANCE, by_chance(share, draws))


def none_wrong(name: str, wrong: list[int]) -> Check:
    """A check that every experiment has to pass; `wrong` are those that do not."""
    found = f"not in {len(wrong)} experiments, the first is {wrong[0]}" if wrong else "yes"
    return Check(name, found, not wrong)
