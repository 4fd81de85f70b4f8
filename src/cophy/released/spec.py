"""Which experiments of a released dataset are read, and the lists of ids that split them."""

import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.released.formats import ReleasedFormat
from cophy.scenario import Scenario
from cophy.untrusted_files import BrokenFileError, read_text

INDEX_VERSION = 1  # raise it when the arrays of an index, or how they are read, change
EXPERIMENTS_PER_SHARD = 500  # ours: a few MiB of states
ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # no path to another folder


@dataclass(frozen=True)
class ReleasedSpec:
    """The experiments of a folder, read as a scenario with its grid and clock. ids: its subfolders."""

    scenario: Scenario
    num_objects: int
    released_format: ReleasedFormat
    directory: Path
    ids: tuple[str, ...]

    @property
    def num_experiments(self) -> int:
        """Number of subfolders, broken and empty ones included."""
        return len(self.ids)

    @property
    def num_shards(self) -> int:
        """Number of files of the index."""
        return -(-len(self.ids) // EXPERIMENTS_PER_SHARD)

    def experiments_of_shard(self, shard: int) -> range:
        """Return the indices of the experiments in a shard."""
        first = shard * EXPERIMENTS_PER_SHARD
        return range(first, min(first + EXPERIMENTS_PER_SHARD, len(self.ids)))

    def reading(self) -> dict[str, Any]:
        """Return everything that the index depends on, except the content of the released files."""
        scenario = asdict(self.scenario)
        read_as = {key: scenario[key] for key in ("name", "colors", "confounders", "gravity_z", "clock")}
        return {
            "format": INDEX_VERSION,
            # the released format; the key stays "layout" because the names of indices on disk are hashes of this
            "layout": self.released_format.name,
            "directory": str(self.directory.resolve()),
            "num_objects": self.num_objects,
            "scenario": read_as,
            "ids": hashlib.sha256(" ".join(self.ids).encode()).hexdigest(),
        }

    @cached_property
    def id(self) -> str:
        """Name of the index: number of objects, format and a hash of `reading`."""
        text = json.dumps(self.reading(), sort_keys=True)
        return f"{self.num_objects}-{self.released_format.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def list_experiments(directory: Path) -> tuple[str, ...]:
    """Return the subfolders of a folder that are named like an id, numbers in numerical order. Links do not count.

    Raises:
        CophyError: there are none.
    """
    try:
        with os.scandir(directory) as entries:
            names = [e.name for e in entries if e.is_dir(follow_symlinks=False) and ID.fullmatch(e.name)]
    except OSError as error:
        remedy = "source.root= is the folder that holds ballsCF, blocktowerCF, …"
        raise CophyError(f"{directory} cannot be listed ({error.strerror}): {remedy}") from error
    if not names:
        raise CophyError(f"{directory} holds no experiments")
    return tuple(sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name)))


def read_lists(
    directories: Sequence[Path], names: Sequence[Sequence[str]]
) -> tuple[list[Path], tuple[tuple[str, ...], ...]]:
    """Read the lists of train, val and test, each from the first file that has one of its names.

    Returns:
        The files, and the ids in each.

    Raises:
        CophyError: a list is missing or broken, or an id is in two of them.
    """
    paths = []
    for candidates in names:
        path = next((d / name for d in directories for name in candidates if (d / name).exists()), None)
        if path is None:
            raise CophyError(
                f"there is no {' or '.join(candidates)} in {' or '.join(map(str, directories))}: put the released lists of "
                "ids there, or name their folder with source.splits="
            )
        paths.append(path)
    ids = tuple(_read_list(path) for path in paths)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        if shared := set(ids[first]) & set(ids[second]):
            raise CophyError(
                f"{paths[first]} and {paths[second]} share {len(shared)} ids, for example {min(shared)}: "
                f"{SPLITS[second]} experiments must not be among those of {SPLITS[first]}"
            )
    return paths, ids


def _read_list(path: Path) -> tuple[str, ...]:
    try:
        lines = [line.strip() for line in read_text(path.resolve()).splitlines()]
    except BrokenFileError as error:
        raise CophyError(str(error)) from error
    for number, line in enumerate(lines, start=1):
        if line and not ID.fullmatch(line):
            raise CophyError(f"{path}, line {number}: {line[:60]!r} is not the id of an experiment")
    return tuple(dict.fromkeys(filter(None, lines)))
