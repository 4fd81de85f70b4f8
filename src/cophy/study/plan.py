"""Settings of a study, and its plan: which experiments a participant sees, in which setting and in which order.

The plan is a pure function of the study's seed and the participant's number. Twin pairs are dealt into
m = num_pairs / num_assignments hands, which spread every kind of pair (the cells of its twins) evenly. Participant n sees
one hand in the setting without AB and the next hand in the setting with AB. After 2 m participants, every experiment was
seen once in each setting.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from cophy.errors import CophyError

SETTINGS = ("non_cf", "cf")  # without AB, with AB
MIN_RESOLUTION, MAX_RESOLUTION = 64, 1024  # pixels


@dataclass
class StudySettings:
    """Settings that all participants of a study share; conf/study.yaml explains the values.

    Attributes:
        seed: Seed of the plan.
        num_pairs: Twin pairs of the test split that are shown.
        num_assignments: Tasks of each setting per participant.
        seconds: Time to click.
        tolerance_s: Time by which an answer may arrive later than that.
        resolution: Width and height of the images, pixels.
    """

    seed: int
    num_pairs: int
    num_assignments: int
    seconds: float
    tolerance_s: float
    resolution: int

    def __post_init__(self) -> None:
        if self.num_assignments < 1 or self.num_pairs % self.num_assignments or self.num_pairs < self.num_tasks:
            raise ValueError(
                f"study.num_pairs={self.num_pairs} must be a multiple of study.num_assignments={self.num_assignments} "
                "and at least twice as large: nobody sees a pair in both settings"
            )
        if not (self.seconds > 0 and self.tolerance_s >= 0 and self.seed >= 0):
            raise ValueError("study: seconds must be positive, tolerance_s and seed must not be negative")
        check_resolution(self.resolution)

    @property
    def num_tasks(self) -> int:
        """Number of tasks of one participant, without practice."""
        return len(SETTINGS) * self.num_assignments

    def study_id(self, scenario: str, data: str, split: str) -> str:
        """Return the name of a study; only participants of the same study are counted together.

        Args:
            split: Name of the split whose test half is shown.
        """
        text = json.dumps({"data": f"{scenario}/{data}", "split": split, **asdict(self)}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def check_resolution(resolution: int) -> None:
    """Raise ValueError if images of this resolution are too small to be seen or too large to be sent."""
    if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        raise ValueError(f"study.resolution={resolution} must be between {MIN_RESOLUTION} and {MAX_RESOLUTION} pixels")


@dataclass
class Limits:
    """Limits of one network address.

    Attributes:
        requests_per_second: Requests that are answered.
        people_per_minute: Participants who may begin.
    """

    requests_per_second: float
    people_per_minute: float

    def __post_init__(self) -> None:
        if self.requests_per_second < 1 or self.people_per_minute < 1:
            raise ValueError("limits: both must be at least 1")


class StudyTask(NamedTuple):
    """One experiment that a participant answers, in one of SETTINGS."""

    experiment: int
    setting: str


def select_pairs(pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> np.ndarray:
    """Select the twin pairs of a study so that every kind has the same share as in all pairs.

    Args:
        pairs: (pair,) indices in the dataset.
        kinds: (pair, 2) cells of the twins.

    Returns:
        (num_pairs,) indices in the dataset, sorted.

    Raises:
        CophyError: There are fewer pairs than the study needs.
    """
    if len(pairs) < settings.num_pairs:
        raise CophyError(
            f"study.num_pairs={settings.num_pairs} is more than the {len(pairs)} twin pairs of the test split: "
            "set a larger size=, or smaller study.num_pairs= and study.num_assignments="
        )
    order = _order_by_kind(kinds, np.random.default_rng((settings.seed, 0)))
    return np.sort(pairs[order[np.arange(settings.num_pairs) * len(pairs) // settings.num_pairs]])


def plan_tasks(number: int, pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> list[StudyTask]:
    """Return the tasks of a participant in order, without practice.

    Args:
        number: Number of the participant, from 0.
        pairs: (num_pairs,) see `select_pairs`.
        kinds: (num_pairs, 2) cells of their twins.
    """
    num_hands = len(pairs) // settings.num_assignments
    deck, place = divmod(number, num_hands)
    rng = np.random.default_rng((settings.seed, 1, deck // 2))  # decks 2 d and 2 d + 1 show complementary twins
    order = _order_by_kind(kinds, rng)
    hands = np.arange(len(order)) % num_hands
    twins = (np.arange(len(order)) // num_hands + rng.integers(2, size=num_hands)[hands] + deck) % 2
    experiments = 2 * pairs[order] + twins
    tasks = [
        StudyTask(int(experiment), setting)
        for shift, setting in enumerate(SETTINGS)
        for experiment in experiments[hands == (place + shift) % num_hands]
    ]
    shuffled = np.random.default_rng((settings.seed, 2, number)).permutation(len(tasks))
    return [tasks[index] for index in shuffled]


def practice_tasks(pairs: np.ndarray, settings: StudySettings) -> list[StudyTask]:
    """Return one task of each setting, the same for all participants.

    Args:
        pairs: (pair,) indices in the dataset, none of the test split.
    """
    rng = np.random.default_rng((settings.seed, 3))
    selected: list[int] = rng.permutation(pairs)[: len(SETTINGS)].tolist()
    return [
        StudyTask(2 * pair + int(rng.integers(2)), setting) for pair, setting in zip(selected, SETTINGS, strict=True)
    ]


def _order_by_kind(kinds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (pair,) indices in random order, pairs of one kind next to each other."""
    return np.lexsort((rng.random(len(kinds)), kinds[:, 1], kinds[:, 0]))
