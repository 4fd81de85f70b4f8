"""Training, validation and test experiments, the order in which they are stored, and the parts that `split=` names."""

from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from cophy.errors import CophyError, check_name
from cophy.scenario import Scenario, Shape
from cophy.scenario.confounders import CONFOUNDERS_OF_OBJECTS

SPLITS = ("train", "val", "test")
FRACTIONS = (0.7, 0.2, 0.1)  # paper Sec. 3


EARLIER = ("num_objects", "moving", "configurations")  # keys of a part that checkpoints have always stored


@dataclass
class Part:
    """Experiments that are trained on, or tested on: those that meet every condition.

    A condition is met by experiments, not by pairs: twins differ in confounders, so one may belong to a part without the other.
    Metrics of twins count the pairs of which both belong to it.

    moving: sphere or cylinder, to select the experiments in which it moves (paper Table 4).
    configurations: seen or unseen, to select by confounder configuration (paper Table 2, †; `Scenario.seen_configurations`).
    where: names of confounders -> the values that each object of A may have, or the gravity.
    cell, do_operation: names of the scenario, to select by the kind of experiment, or of do-operation.
    """

    num_objects: int
    moving: str | None = None
    configurations: str | None = None
    where: dict[str, Any] = field(default_factory=dict)
    cell: Any = None
    do_operation: Any = None

    def __post_init__(self) -> None:
        if self.moving not in (None, "sphere", "cylinder"):
            raise ValueError(f"split: moving={self.moving} is neither sphere nor cylinder")
        if self.configurations not in (None, "seen", "unseen"):
            raise ValueError(f"split: configurations={self.configurations} is neither seen nor unseen")
        self.where = {name: _as_list(values) for name, values in self.where.items()}
        self.cell, self.do_operation = (_as_list(names) for names in (self.cell, self.do_operation))

    def check(self, key: str, scenario: Scenario) -> None:
        """Raise CophyError, which calls the part `key`, if it names what the scenario does not have."""
        grid = {each.name: getattr(scenario.confounders, each.name) for each in fields(scenario.confounders)}
        if unknown := self.where.keys() - grid.keys():
            raise CophyError(f"{key}.where.{min(unknown)} does not exist; there are {', '.join(grid)}")
        if self.configurations is not None and scenario.seen_configurations(self.num_objects, data_seed=0) is None:
            raise CophyError(
                f"{key}.configurations={self.configurations}: {scenario.name} has no unseen configurations"
            )
        choices = {
            **{f"where.{name}": (values, grid[name]) for name, values in self.where.items()},
            "cell": (self.cell, scenario.cells()),
            "do_operation": (self.do_operation, scenario.do_operations),
        }
        for name, (values, known) in choices.items():
            if wrong := [value for value in values or () if value not in known]:
                existing = ", ".join(f"{each:g}" if isinstance(each, float) else each for each in known)
                raise CophyError(f"{key}.{name}={wrong[0]} does not exist; {scenario.name} has {existing}")

    def conditions(self, arrays: dict[str, np.ndarray], scenario: Scenario) -> dict[str, np.ndarray]:
        """Return which experiments of a dataset meet each condition, (experiment,) bool."""
        masks = {}
        if self.moving is not None:
            moves = np.linalg.norm(arrays["states"][:, 0, 0, :, 7:10], axis=-1) > 0
            masks["moving"] = (moves & (arrays["shape"] == Shape[self.moving.upper()])).any(axis=-1)
        if self.configurations is not None:
            masks["configurations"] = arrays["seen"] == (self.configurations == "seen")
        for name, values in self.where.items():
            if name in CONFOUNDERS_OF_OBJECTS:
                met = _is_among(arrays[name], values) | ~arrays["presence"].any(axis=1)
                masks[f"where.{name}"] = met.all(axis=1)
            else:
                masks[f"where.{name}"] = _is_among(arrays["gravity"][:, "xy".index(name[-1])], values)
        for key, names in (("cell", scenario.cells()), ("do_operation", scenario.do_operations)):
            if (chosen := getattr(self, key)) is not None:
                if key not in arrays:
                    raise CophyError(f"split: {key} is unknown in released data")
                masks[key] = np.isin(arrays[key], [list(names).index(name) for name in chosen])
        return masks

    def select(self, arrays: dict[str, np.ndarray], scenario: Scenario) -> np.ndarray:
        """Return which experiments of a dataset belong to this part, (experiment,) bool."""
        everything = np.ones(len(arrays["split"]), dtype=bool)
        return np.logical_and.reduce([everything, *self.conditions(arrays, scenario).values()])

    def select_split(self, arrays: dict[str, np.ndarray], split: str, scenario: Scenario) -> np.ndarray:
        """Return which experiments belong to this part and to train, val or test, (experiment,) bool."""
        return self.select(arrays, scenario) & (arrays["split"] == SPLITS.index(split))

    def as_plain(self) -> dict[str, Any]:
        """Return the keys as plain values, without unset ones that checkpoints of earlier versions lack."""
        return {name: value for name, value in asdict(self).items() if name in EARLIER or value}


def _as_list(value: Any) -> Any:
    """Return a single value as a list, and numbers as floats."""
    if value is None:
        return None
    values = value if isinstance(value, list) else [value]
    return [float(each) if isinstance(each, int) else each for each in values]


def _is_among(array: np.ndarray, values: list[float]) -> np.ndarray:
    return np.isclose(array[..., None], values).any(axis=-1)  # arrays have single precision


@dataclass
class Split:
    """Parts of the data to train and validate on, and to test on (files in conf/split).

    scenario: name of the one that a split of the user belongs to; a scenario names its other splits (`Task.splits`).
    epochs_factor: factor of `trainer.max_epochs` for predictors. Half of the data needs twice as many epochs for about as many
    optimiser steps.
    """

    name: str
    train: Part
    test: Part
    epochs_factor: int = 1
    scenario: str | None = None

    def __post_init__(self) -> None:
        check_name("split.name", self.name)
        if self.epochs_factor < 1:
            raise ValueError(f"split: epochs_factor={self.epochs_factor} must be at least 1")

    def counts(self, num_objects: list[int] | None = None) -> list[int]:
        """Return these numbers of objects, by default those that are trained and tested on."""
        return sorted(num_objects or {self.train.num_objects, self.test.num_objects})

    def check_scenario(self, scenario: Scenario) -> None:
        """Raise CophyError if the split does not belong to this scenario, or names what the scenario does not have."""
        if self.scenario != scenario.name and self.name not in scenario.task.splits:
            choices = ", ".join(scenario.task.splits)
            hint = f"a split of your own needs the line `scenario: {scenario.name}`"
            raise CophyError(f"split={self.name} does not go with {scenario.name}: use {choices}; {hint}")
        for key in ("train", "test"):
            getattr(self, key).check(f"split.{key}", scenario)


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
