"""Specification of a generated dataset: the configuration that determines every byte of it, and its name on disk."""

import hashlib
import json
import shlex
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from cophy.dataset.splits import StoredOrder, stored_order
from cophy.errors import CophyError, check_name
from cophy.scenario import Scenario

FORMAT_VERSION = 4  # increase it when the arrays of a shard or the experiments of all scenarios change

MAX_EXPERIMENTS = 10_000_000  # ours: a hundred times the paper's, months of generation


@dataclass
class Size:
    """How many experiments to generate, per scenario and number of objects (files in conf/size)."""

    name: str
    experiments_per_shard: int
    num_experiments: dict[str, dict[str, int]]

    def __post_init__(self) -> None:
        check_name("size.name", self.name)
        counts = [count for per_scenario in self.num_experiments.values() for count in per_scenario.values()]
        if any(count < 2 or count % 2 for count in [self.experiments_per_shard, *counts]):
            raise ValueError(f"size {self.name}: twins come in pairs, so all counts are even and at least 2")
        if max(counts, default=0) > MAX_EXPERIMENTS:
            raise ValueError(f"size {self.name}: {max(counts)} experiments are more than {MAX_EXPERIMENTS:,}")


@dataclass(frozen=True)
class DatasetSpec:
    """One generated dataset.

    data_seed: seed of its experiments and splits. overrides: command-line keys by which scenario and size differ from the files
    of their names; they only occur in commands that messages suggest.
    """

    scenario: Scenario
    num_objects: int
    size: Size
    data_seed: int
    overrides: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        scenario, count = self.scenario, self.num_objects
        if count not in scenario.num_objects:
            more = ",".join(map(str, [*scenario.num_objects, count]))
            try:
                replace(scenario, num_objects=[*scenario.num_objects, count])
            except ValueError as error:  # it cannot have so many
                raise CophyError(f"num_objects={count}: {error}") from error
            raise CophyError(
                f"num_objects={count}: scenario={scenario.name} has {', '.join(map(str, scenario.num_objects))}; "
                f"for {count}, add 'scenario.num_objects=[{more}]'"
            )
        counts = self.size.num_experiments.get(scenario.name, {})
        if str(count) not in counts:
            raise CophyError(
                f"num_objects={count}: size={self.size.name} counts experiments of {scenario.name} with "
                f"{', '.join(counts) or 'no'} objects; for {count}, add +size.num_experiments.{scenario.name}.{count}=48"
            )

    @property
    def num_experiments(self) -> int:
        """Number of experiments, which is even."""
        return self.size.num_experiments[self.scenario.name][str(self.num_objects)]

    @property
    def num_shards(self) -> int:
        """Number of files."""
        return -(-self.num_experiments // self.size.experiments_per_shard)

    def experiments_of_shard(self, shard: int) -> range:
        """Return the indices of the experiments in a shard."""
        first = shard * self.size.experiments_per_shard
        return range(first, min(first + self.size.experiments_per_shard, self.num_experiments))

    @property
    def order(self) -> StoredOrder:
        """Which experiment each place holds. It says which test experiments are twins, so only scoring and audits read it."""
        return stored_order(
            self.num_experiments,
            self.size.experiments_per_shard,
            num_objects=self.num_objects,
            data_seed=self.data_seed,
        )

    def generating_configuration(self) -> dict[str, Any]:
        """Return everything the bytes depend on, as plain values. `task` only says how predictions are evaluated."""
        scenario = {key: value for key, value in asdict(self.scenario).items() if key != "task"}
        search_version = self.scenario.search_version()
        return {
            "format": FORMAT_VERSION,
            **({"search": search_version} if search_version > 1 else {}),  # data of the first version keep their id
            "scenario": scenario,
            "num_objects": self.num_objects,
            "num_experiments": self.num_experiments,
            "experiments_per_shard": self.size.experiments_per_shard,
            "seed": self.data_seed,
        }

    @property
    def id(self) -> str:
        """Name of the directory: objects, size and a hash of the configuration, so that no outdated data are used."""
        text = json.dumps(self.generating_configuration(), sort_keys=True)
        return f"{self.num_objects}-{self.size.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def directory(self, data_dir: Path) -> Path:
        """Return the directory of the dataset."""
        return data_dir / self.scenario.name / self.id

    def command_line_keys(self, directory: Path) -> str:
        """Return the command-line keys for this dataset in its directory."""
        names = f"scenario={self.scenario.name} size={self.size.name} 'num_objects=[{self.num_objects}]'"
        places = (f"data_seed={self.data_seed}", f"data_dir={directory.parents[1]}")
        return " ".join([names, *map(shlex.quote, [*places, *self.overrides])])
