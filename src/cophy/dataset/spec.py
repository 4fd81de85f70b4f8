"""Which dataset is meant: the configuration that determines every byte of it, and its name on disk."""

import hashlib
import json
import shlex
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cophy.errors import CophyError, check_name
from cophy.scenario import Scenario

FORMAT_VERSION = 3  # raise it when the arrays of a shard change, or the experiments of every scenario do


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


@dataclass(frozen=True)
class DatasetSpec:
    """One generated dataset.

    data_seed: all randomness of its experiments and of its splits follows from it. overrides: what scenario and size change
    beyond their names, as a command line has it; only commands are made of it.
    """

    scenario: Scenario
    num_objects: int
    size: Size
    data_seed: int
    overrides: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        if str(self.num_objects) not in self.size.num_experiments.get(self.scenario.name, {}):
            known = ", ".join(self.size.num_experiments.get(self.scenario.name, {})) or "none"
            raise CophyError(
                f"size {self.size.name} has no count for {self.scenario.name} with {self.num_objects} objects, "
                f"only for: {known}; see num_objects= and conf/size/{self.size.name}.yaml"
            )

    @property
    def num_experiments(self) -> int:
        """Experiments in the dataset, an even number."""
        return self.size.num_experiments[self.scenario.name][str(self.num_objects)]

    @property
    def num_shards(self) -> int:
        """Files the experiments are stored in."""
        return -(-self.num_experiments // self.size.experiments_per_shard)

    def experiments_of_shard(self, shard: int) -> range:
        """Indices of the experiments in a shard."""
        first = shard * self.size.experiments_per_shard
        return range(first, min(first + self.size.experiments_per_shard, self.num_experiments))

    def generating_configuration(self) -> dict[str, Any]:
        """Everything the bytes depend on, as plain values. `task` only says how predictions are judged."""
        scenario = {key: value for key, value in asdict(self.scenario).items() if key != "task"}
        searched = self.scenario.search_version()
        return {
            "format": FORMAT_VERSION,
            **({"search": searched} if searched > 1 else {}),  # so that data of a first version keep their id
            "scenario": scenario,
            "num_objects": self.num_objects,
            "num_experiments": self.num_experiments,
            "experiments_per_shard": self.size.experiments_per_shard,
            "seed": self.data_seed,
        }

    @property
    def id(self) -> str:
        """Name of the dataset's directory: objects, size and a hash, so that a changed constant reuses no stale data."""
        text = json.dumps(self.generating_configuration(), sort_keys=True)
        return f"{self.num_objects}-{self.size.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def directory(self, data_dir: Path) -> Path:
        """Where the dataset lies."""
        return data_dir / self.scenario.name / self.id

    def command_line_keys(self, directory: Path) -> str:
        """Return the keys by which a command names this dataset in its directory."""
        names = f"scenario={self.scenario.name} size={self.size.name} 'num_objects=[{self.num_objects}]'"
        places = f"data_seed={self.data_seed} data_dir={directory.parents[1]}"
        return " ".join([names, places, *map(shlex.quote, self.overrides)])
