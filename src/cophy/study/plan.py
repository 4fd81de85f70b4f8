"""Which experiments a participant sees, in which setting and order: a pure function of the seed and the number.

Twin pairs are dealt to m = num_pairs / num_assignments hands, every kind of pair evenly. Participant n has one hand in the
setting without AB, and the next in the setting with AB. After 2 m participants every experiment was seen once in each setting.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cophy.errors import CophyError
from cophy.study.study_settings import SETTINGS, StudySettings


class Assignment(NamedTuple):
    """One experiment that a participant is asked about, in one of SETTINGS."""

    experiment: int
    setting: str


def chosen_pairs(pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> np.ndarray:
    """(num_pairs,) of the given pairs: every kind with its share of all.

    Args:
        pairs: (pair,) index in the dataset.
        kinds: (pair, 2) cells of the twins.
        settings: Of the study.

    Raises:
        CophyError: There are fewer.
    """
    if len(pairs) < settings.num_pairs:
        raise CophyError(
            f"the test split has {len(pairs)} twin pairs, study.num_pairs={settings.num_pairs} asks for more: "
            "take a larger size=, or a smaller study.num_pairs= and study.num_assignments="
        )
    order = _by_kind(kinds, np.random.default_rng((settings.seed, 0)))
    return np.sort(pairs[order[np.arange(settings.num_pairs) * len(pairs) // settings.num_pairs]])


def assignments_of(number: int, pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> list[Assignment]:
    """What participant `number` (from 0) is asked, in order.

    Args:
        number: Of the participant.
        pairs: (num_pairs,) see `chosen_pairs`.
        kinds: (num_pairs, 2) cells of their twins.
        settings: Of the study.
    """
    num_hands = len(pairs) // settings.num_assignments
    deck, place = divmod(number, num_hands)
    rng = np.random.default_rng((settings.seed, 1, deck // 2))  # decks 2 d and 2 d + 1 show complementary twins
    order = _by_kind(kinds, rng)
    twin = (np.arange(len(order)) // num_hands + rng.integers(2, size=num_hands)[_hand(order, num_hands)] + deck) % 2
    experiments = 2 * pairs[order] + twin
    found = [
        Assignment(int(experiment), setting)
        for shift, setting in enumerate(SETTINGS)
        for experiment in experiments[_hand(order, num_hands) == (place + shift) % num_hands]
    ]
    mixed = np.random.default_rng((settings.seed, 2, number)).permutation(len(found))
    return [found[index] for index in mixed]


def practice(pairs: np.ndarray, settings: StudySettings) -> list[Assignment]:
    """One of each setting, the same for all participants.

    Args:
        pairs: (pair,) index in the dataset; none of the test split.
        settings: Of the study.
    """
    rng = np.random.default_rng((settings.seed, 3))
    chosen: Sequence[int] = rng.permutation(pairs)[: len(SETTINGS)].tolist()
    return [
        Assignment(2 * pair + int(rng.integers(2)), setting) for pair, setting in zip(chosen, SETTINGS, strict=True)
    ]


def _by_kind(kinds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(pair,) places in random order, those of one kind side by side."""
    return np.lexsort((rng.random(len(kinds)), kinds[:, 1], kinds[:, 0]))


def _hand(order: np.ndarray, num_hands: int) -> np.ndarray:
    """(pair,) the hand that each card of a deck is dealt to, one after the other."""
    return np.arange(len(order)) % num_hands
