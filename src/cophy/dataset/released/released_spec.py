"""Which experiments of a folder are meant, and as what they are read."""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cophy.dataset.released.id_lists import ID
from cophy.dataset.released.protocol import ReleasedFormat
from cophy.errors import CophyError
from cophy.scenario import Scenario

FORMAT_VERSION = 1  # raise it when the arrays of an index, or what is read into them, change
EXPERIMENTS_PER_SHARD = 500  # ours: a few MiB of states


@dataclass(frozen=True)
class ReleasedSpec:
    """Which experiments are meant: a folder's, read as a scenario with its grid and clock. ids: its subfolders."""

    scenario: Scenario
    num_objects: int
    released_format: ReleasedFormat
    directory: Path
    ids: tuple[str, ...]

    @property
    def num_experiments(self) -> int:
        """Subfolders, broken and empty ones included."""
        return len(self.ids)

    @property
    def num_shards(self) -> int:
        """Files of the index."""
        return -(-len(self.ids) // EXPERIMENTS_PER_SHARD)

    def experiments_of_shard(self, shard: int) -> range:
        """Indices of the experiments in a shard."""
        first = shard * EXPERIMENTS_PER_SHARD
        return range(first, min(first + EXPERIMENTS_PER_SHARD, len(self.ids)))

    def reading(self) -> dict[str, Any]:
        """All that the index depends on besides what is in the files."""
        scenario = asdict(self.scenario)
        read_as = {key: scenario[key] for key in ("name", "colors", "confounders", "gravity_z", "clock")}
        return {
            "format": FORMAT_VERSION,
            # the released format; the key stays "layout" because the names of indices on disk are hashes of this
            "layout": self.released_format.name,
            "directory": str(self.directory.resolve()),
            "num_objects": self.num_objects,
            "scenario": read_as,
            "ids": hashlib.sha256(" ".join(self.ids).encode()).hexdigest(),
        }

    @cached_property
    def id(self) -> str:
        """Name of the index: objects, format and a hash of what is read, and how."""
        text = json.dumps(self.reading(), sort_keys=True)
        return f"{self.num_objects}-{self.released_format.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def listing(directory: Path) -> tuple[str, ...]:
    """The experiments of a folder: its subfolders with the name of an id, numbers in their order. Links are none."""
    try:
        with os.scandir(directory) as entries:
            names = [e.name for e in entries if e.is_dir(follow_symlinks=False) and ID.fullmatch(e.name)]
    except OSError as error:
        raise CophyError(
            f"{directory} cannot be listed ({error.strerror}): source.root= is the folder that holds ballsCF, blocktowerCF, …"
        ) from error
    if not names:
        raise CophyError(f"{directory} holds no experiments")
    return tuple(sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name)))
