"""How simulated participants answer: at random, as if nothing moved, as if AB came again, or near the truth."""

from collections.abc import Callable, Mapping

import numpy as np

from cophy.study.plan import Assignment
from cophy.study.results.judging import REFERENCE_RESOLUTION
from cophy.study.scenes import Scenes

Pixels = dict[int, tuple[float, float]]  # slot -> x, y
# from the pictures' scenes, what is asked, and draws, to where objects end
Strategy = Callable[[Scenes, Assignment, np.random.Generator], Pixels]

# paper Table 1, of people: mean error of an answer in the setting without AB, and with it; pixels of 448
MEAN_ERROR = {"non_cf": 58.57, "cf": 54.54}
# ours: log-normal spread of the noise of an answer, which brings the standard deviation over answers near the paper's 34
SPREAD = 0.5
MEAN_OF_NORM = np.sqrt(np.pi / 2)  # of a vector of two standard normal numbers


def _at_random(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """Anywhere in the picture."""
    size = scenes.resolution
    return {slot: (size * rng.random(), size * rng.random()) for slot in sorted(scenes.slots(assignment.experiment))}


def _stays(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """Every object stays where it is in C."""
    return scenes.starts(assignment.experiment)


def _as_in_ab(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """With AB, every object moves as it did there; without, it stays."""
    if assignment.setting == "cf":
        return scenes.moved_as_in_ab(assignment.experiment)
    return scenes.starts(assignment.experiment)


def _near_the_truth(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """The truth with noise: an answer is as wrong, on average, as the paper's people are in this setting."""
    mean = MEAN_ERROR[assignment.setting] * scenes.resolution / REFERENCE_RESOLUTION
    noise = mean / MEAN_OF_NORM * rng.lognormal(-(SPREAD**2) / 2, SPREAD)  # mean of the factor: 1
    ends = scenes.ends(assignment.experiment)
    return {slot: (x + noise * rng.normal(), y + noise * rng.normal()) for slot, (x, y) in ends.items()}


STRATEGIES: Mapping[str, Strategy] = {
    "random": _at_random,
    "stays": _stays,
    "as_in_ab": _as_in_ab,
    "noisy_oracle": _near_the_truth,
}
