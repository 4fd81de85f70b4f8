"""Files shard-00000.h5 ... of one directory: made whole, vouched for by a manifest, and read safely."""

import errno
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from cophy.atomic_files import sha256
from cophy.dataset.state_features import Arrays
from cophy.dataset.store.hdf5_arrays import DamagedShardError, Fields, attribute, check_plain, reading
from cophy.dataset.store.manifest import MANIFEST, DamagedManifestError, read_checksums, write_manifest
from cophy.errors import CophyError
from cophy.scenario import Scenario

IDENTITY = "shard"  # the attribute of a file


class Sharded(Protocol):
    """Experiments in an order, so many to a file."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def num_objects(self) -> int: ...

    @property
    def num_experiments(self) -> int: ...

    @property
    def num_shards(self) -> int: ...

    def experiments_of_shard(self, shard: int) -> range:
        """Indices of the experiments in a shard."""
        ...


class ShardSet(ABC):
    """Arrays of all experiments of a dataset, in shards of one directory: a pure function of a configuration.

    A subclass says which fields a shard has, how a shard is made, what is checked beyond shapes and types, and of which
    other files a shard was made.

    title: what is in it, for people. command: what makes, continues or repairs it.
    """

    def __init__(self, spec: Sharded, directory: Path, *, title: str, command: str) -> None:
        self.spec, self.directory, self.title, self.command = spec, directory, title, command

    @abstractmethod
    def fields(self, shard: int) -> Fields:
        """The arrays of a shard."""

    @property
    def why_slow(self) -> str:
        """What may be the matter where not even the first experiment is done after a while; "" where nothing is known."""
        return ""

    @abstractmethod
    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Make one shard.

        Args:
            path: the file to write.
            shard: its number.
            advance: to be called with the number of experiments just done.

        Returns:
            What it took, per unit, to be logged.
        """

    def num_made(self, shard: int) -> int:
        """How many experiments of a shard `write` advances by."""
        return len(self.spec.experiments_of_shard(shard))

    @abstractmethod
    def description(self) -> dict[str, Any]:
        """What the manifest says besides versions and checksums."""

    def sources(self, shard: int) -> dict[str, str]:
        """SHA-256 of the files that a shard was made of; they are stored among its attributes."""
        return {}

    def attributes(self, shard: int) -> dict[str, str]:
        """What a file says of itself: which shard of which set it is, and of which files it was made."""
        return {IDENTITY: f"{self.directory.name}/{shard}", **self.sources(shard)}

    def remarks(self) -> list[str]:
        """What to say where the set is not there: a sentence about each thing beside it that may be taken for it."""
        return []

    def check_arrays(self, arrays: Arrays, shard: int) -> None:  # noqa: B027, nothing unless overridden
        """Raise DamagedShardError where values cannot be, although shapes and types are right."""

    def check(self, path: Path, shard: int) -> None:
        """Read it all; raise DamagedShardError unless the file is whole and holds what this set says."""
        self._read(path, shard)

    def path(self, shard: int) -> Path:
        """File of a shard."""
        return self.directory / f"shard-{shard:05d}.h5"

    def is_finished(self) -> bool:
        """Whether generation came to its end and every shard is still there; reading checks what is in them."""
        return self.checksums() is not None and all(path.exists() for path in self._paths())

    def checksums(self) -> dict[str, str] | None:
        """SHA-256 per shard as the manifest has them, or None where there is no manifest yet."""
        try:
            return read_checksums(self.directory, [path.name for path in self._paths()])
        except DamagedManifestError as error:
            path = self.directory / MANIFEST
            raise CophyError(f"{path} is damaged ({error}): delete it and run `{self.command}`") from error

    def finished_checksums(self) -> dict[str, str]:
        """The checksums of a finished set; an unfinished one is an error that names the remedy."""
        checksums = self.checksums()
        if checksums is None:
            remarks = "".join(f" ({remark})" for remark in self.remarks())
            raise CophyError(f"{self.directory} is not finished: run `{self.command}`{remarks}")
        return checksums

    def checksum(self, shard: int) -> str:
        """SHA-256 of a shard of a finished set."""
        return self.finished_checksums()[self.path(shard).name]

    def verify(self, shard: int, checksum: str | None) -> None:
        """Raise DamagedShardError unless the shard is there, is the one of its name, and is whole.

        Args:
            shard: its number.
            checksum: that it has to have; where none is known, the file says itself which shard it is.
        """
        self._compare(shard, checksum)
        if checksum is None:
            found, expected = attribute(self.path(shard), IDENTITY), self.attributes(shard)[IDENTITY]
            if found != expected:
                raise DamagedShardError(f"it is shard {found}, expected {expected}")
        self.check(self.path(shard), shard)

    def read(self, shard: int) -> Arrays:
        """The arrays of one shard of a finished set, checked against its checksum."""
        return self._verified(shard, self.checksum(shard))

    def load(self, reduced: Callable[[Arrays], Arrays] = lambda arrays: arrays) -> Arrays:
        """All arrays, experiments in order; every shard is checked against its checksum.

        Args:
            reduced: Makes of the arrays of a shard what is kept of them, so that the rest is never in memory all at once.
        """
        checksums = self.finished_checksums()
        shards = [reduced(self._verified(shard, checksums[path.name])) for shard, path in enumerate(self._paths())]
        return {name: np.concatenate([arrays[name] for arrays in shards]) for name in shards[0]}

    def opened(self, path: Path, shard: int) -> AbstractContextManager[dict[str, h5py.Dataset]]:
        """The arrays of a shard's file, not read yet."""
        return reading(path, self.fields(shard), self.sources(shard))

    def write_manifest(self) -> None:
        """Vouch for a finished set."""
        write_manifest(self.directory, [path.name for path in self._paths()], self.description())

    @contextmanager
    def explained(self, shard: int) -> Iterator[None]:
        """Turn damage found while reading a shard into an error that names the file and the remedy."""
        try:
            yield
        except (DamagedShardError, OSError) as error:
            if isinstance(error, OSError) and error.errno not in (None, errno.ENOENT, errno.EIO):
                raise  # no permission, too many open files: nothing is wrong with the shard
            raise CophyError(
                f"{self.path(shard)} is damaged ({error}): run `{self.command}` to make it again"
            ) from error

    def _paths(self) -> list[Path]:
        return [self.path(shard) for shard in range(self.spec.num_shards)]

    def _compare(self, shard: int, checksum: str | None) -> None:
        check_plain(self.path(shard))
        try:
            found = None if checksum is None else sha256(self.path(shard))
        except OSError as error:
            raise DamagedShardError(error.strerror or str(error)) from error
        if found != checksum:
            raise DamagedShardError(f"its checksum is not the one in {MANIFEST}")

    def _verified(self, shard: int, checksum: str) -> Arrays:
        with self.explained(shard):
            self._compare(shard, checksum)
            return self._read(self.path(shard), shard)

    def _read(self, path: Path, shard: int) -> Arrays:
        with self.opened(path, shard) as stored:
            arrays = {name: np.asarray(array[()]) for name, array in stored.items()}
        self.check_arrays(arrays, shard)
        return arrays
