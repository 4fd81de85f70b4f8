"""Training, validation and test experiments, the order in which they are stored, and the parts that `split=` names."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cophy.errors import CophyError, check_name
from cophy.scenario import Scenario, Shape

SPLITS = ("train", "val", "test")
FRACTIONS = (0.7, 0.2, 0.1)  # paper Sec. 3


@dataclass
class Part:
    """Experiments that are trained on, or tested on.

    moving: sphere or cylinder, to select the experiments in which it moves (paper Table 4).
    configurations: seen or unseen, to select by confounder configuration (paper Table 2, †; `Scenario.seen_configurations`).
    """

    num_objects: int
    moving: str | None = None
    configurations: str | None = None

    def __post_init__(self) -> None:
        if self.moving not in (None, "sphere", "cylinder"):
            raise ValueError(f"split: moving={self.moving} is neither sphere nor cylinder")
        if self.configurations not in (None, "seen", "unseen"):
            raise ValueError(f"split: configurations={self.configurations} is neither seen nor unseen")

    def select(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """Return which experiments of a dataset belong to this part, (experiment,) bool."""
        selected = np.ones(len(arrays["split"]), dtype=bool)
        if self.moving is not None:
            moves = np.linalg.norm(arrays["states"][:, 0, 0, :, 7:10], axis=-1) > 0
            selected &= (moves & (arrays["shape"] == Shape[self.moving.upper()])).any(axis=-1)
        if self.configurations is not None:
            selected &= arrays["seen"] == (self.configurations == "seen")
        return selected

    def select_split(self, arrays: dict[str, np.ndarray], split: str) -> np.ndarray:
        """Return which experiments belong to this part and to train, val or test, (experiment,) bool."""
        return self.select(arrays) & (arrays["split"] == SPLITS.index(split))


@dataclass
class Split:
    """Parts of the data to train and validate on, and to test on (files in conf/split).

    epochs_factor: factor of `trainer.max_epochs` for predictors. Half of the data needs twice as many epochs for about as many
    optimiser steps.
    """

    name: str
    train: Part
    test: Part
    epochs_factor: int = 1

    def __post_init__(self) -> None:
        check_name("split.name", self.name)
        if self.epochs_factor < 1:
            raise ValueError(f"split: epochs_factor={self.epochs_factor} must be at least 1")

    def counts(self, num_objects: list[int] | None = None) -> list[int]:
        """Return these numbers of objects, by default those that are trained and tested on."""
        return sorted(num_objects or {self.train.num_objects, self.test.num_objects})

    def check_scenario(self, scenario: Scenario) -> None:
        """Raise CophyError if the split does not belong to this scenario."""
        if self.name not in scenario.task.splits:
            choices = ", ".join(scenario.task.splits)
            raise CophyError(
                f"split={self.name} does not go with {scenario.name}: use {choices} (scenario.task.splits)"
            )


class StoredOrder(NamedTuple):
    """Which experiment each place of a dataset holds. The order is random, so that a place tells nothing of its experiment.

    Attributes:
        split: (experiment,) index into SPLITS.
        number: (experiment,) index of its twin pair among the pairs of the split, as `Scenario.twin_pair` counts them.
        second: (experiment,) bool, whether it is the second twin.
        pair: (experiment,) twin pair, equal for twins; they are in one shard. Pairs have random numbers, too.
    """

    split: np.ndarray
    number: np.ndarray
    second: np.ndarray
    pair: np.ndarray


@lru_cache(maxsize=64)
def stored_order(num_experiments: int, experiments_per_shard: int, *, num_objects: int, data_seed: int) -> StoredOrder:
    """Return the stored order of a dataset, with 0.7 : 0.2 : 0.1 of its twin pairs in the splits.

    The first pairs of each split are the same whatever the size, so the splits of a small dataset are parts of those of a
    large one.
    """
    num_pairs = num_experiments // 2
    ends = np.round(np.cumsum(FRACTIONS) * num_pairs).astype(int)
    rng = np.random.default_rng((data_seed, num_objects, 0x5B117))
    made = rng.permutation(num_pairs)  # the pair that each number stands for: first those of training
    split = np.searchsorted(ends, made, side="right")
    number = made - np.concatenate([[0], ends])[split]
    shards = [
        rng.permutation(np.arange(first, min(first + experiments_per_shard, num_experiments)))
        for first in range(0, num_experiments, experiments_per_shard)
    ]
    pair, second = np.divmod(np.concatenate(shards), 2)
    order = StoredOrder(split[pair].astype(np.uint8), number[pair], second.astype(bool), pair)
    for array in order:
        array.setflags(write=False)  # it is cached
    return order
