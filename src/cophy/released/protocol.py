"""Lists of ids that say which experiments train, validate and test.

What a released format has to tell: where experiments and lists of ids lie, and how one experiment is read.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from cophy.dataset.splits import SPLITS, Split
from cophy.errors import CophyError
from cophy.released.recording import Recording
from cophy.scenario import Scenario
from cophy.untrusted_files import BrokenFileError, read_text


class ReleasedFormat(Protocol):
    """How someone laid out a dataset on disk.

    name: as `source=` has it. frame_step: every how many frames of states and clips one is taken.
    lists_by_shape: whether the splits by the moving object's shape have lists of their own.
    """

    name: str
    frame_step: int
    lists_by_shape: bool

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        """The folder whose subfolders are the experiments.

        Args:
            root: of the released dataset.
            scenario: of the experiments.
            num_objects: in A of each of them.
        """
        ...

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        """Names that a list of ids may have.

        Args:
            scenario: of the dataset.
            num_objects: in A.
            split: as `split=` has it.
            part: train, val or test.

        Raises:
            CophyError: the format has no lists for this split.
        """
        ...

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        """One experiment.

        Raises:
            BrokenFileError: a file is not what the format says.
            BrokenExperimentError: the files contradict each other or the scenario.
        """
        ...


ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # nothing that leads to another folder
UNLISTED = 255


@dataclass(frozen=True)
class Lists:
    """ids: of train, val and test. paths: the files they are from."""

    ids: tuple[tuple[str, ...], ...]
    paths: tuple[Path, ...]

    @property
    def digest(self) -> str:
        """Eight hexadecimal digits of what is listed."""
        return hashlib.sha256(repr(self.ids).encode()).hexdigest()[:8]

    def split_of(self, ids: Sequence[str]) -> np.ndarray:
        """(experiment,) index into SPLITS, or UNLISTED."""
        place = {name: split for split, names in enumerate(self.ids) for name in names}
        return np.array([place.get(name, UNLISTED) for name in ids], dtype=np.uint8)

    def missing(self, ids: Sequence[str]) -> int:
        """How many listed experiments are not among these."""
        return len({name for names in self.ids for name in names} - set(ids))


def read_lists(directories: Sequence[Path], names: Sequence[Sequence[str]]) -> Lists:
    """Train, val and test, each of the first file found under one of its names; no id may be in two of them."""
    paths = tuple(_found(directories, candidates) for candidates in names)
    ids = tuple(_read(path) for path in paths)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        if shared := set(ids[first]) & set(ids[second]):
            raise CophyError(
                f"{paths[first]} and {paths[second]} share {len(shared)} ids, {min(shared)} for one: "
                f"{SPLITS[second]} experiments must not be among those of {SPLITS[first]}"
            )
    return Lists(ids, paths)


def _found(directories: Sequence[Path], names: Sequence[str]) -> Path:
    for path in (directory / name for directory in directories for name in names):
        if path.exists():
            return path
    raise CophyError(
        f"there is no {' or '.join(names)} in {' or '.join(map(str, directories))}: put the released lists of ids there, "
        "or name their folder with source.splits="
    )


def _read(path: Path) -> tuple[str, ...]:
    try:
        lines = read_text(path.resolve()).splitlines()
    except BrokenFileError as error:
        raise CophyError(str(error)) from error
    for number, line in enumerate(lines, start=1):
        if line.strip() and not ID.fullmatch(line.strip()):
            raise CophyError(f"{path}, line {number}: {line.strip()[:60]!r} is not the id of an experiment")
    return tuple(dict.fromkeys(line.strip() for line in lines if line.strip()))
