"""Files shard-00000.h5 ... of one directory, the manifest that vouches for them, and reading them safely."""

import errno
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from cophy.errors import CophyError
from cophy.files import sha256, write_atomically
from cophy.scenario import Scenario

MANIFEST = "manifest.json"
VERSIONS = ("cophy", "numpy", "pybullet", "h5py", "hdf5plugin", "opencv-python-headless")  # that bytes may depend on


class DamagedShardError(Exception):
    """A file is not a whole shard of its set; the message says what is wrong with it."""


class Sharded(Protocol):
    """Experiments in an order, so many to a file."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def num_experiments(self) -> int: ...

    @property
    def num_shards(self) -> int: ...

    def experiments_of_shard(self, shard: int) -> range:
        """Indices of the experiments in a shard."""
        ...


class ShardSet(ABC):
    """Arrays of all experiments of a dataset, in shards of one directory: a pure function of a configuration.

    title: what is in it, for people. command: what makes, continues or repairs it.
    """

    def __init__(self, spec: Sharded, directory: Path, *, title: str, command: str) -> None:
        self.spec, self.directory, self.title, self.command = spec, directory, title, command

    @abstractmethod
    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Write one shard, calling `advance` with the number of experiments just done; returns what it took, to be logged."""

    @abstractmethod
    def check(self, path: Path, shard: int) -> None:
        """Raise DamagedShardError unless the file is whole and holds what this set says."""

    @abstractmethod
    def description(self) -> dict[str, Any]:
        """What the manifest says besides versions and checksums."""

    def path(self, shard: int) -> Path:
        """File of a shard."""
        return self.directory / f"shard-{shard:05d}.h5"

    def checksums(self) -> dict[str, str] | None:
        """SHA-256 per shard as the manifest has them, or None where there is no manifest yet."""
        path = self.directory / MANIFEST
        if not path.exists():
            return None
        try:
            checksums = json.loads(path.read_bytes())["shards"]
            expected = {self.path(shard).name for shard in range(self.spec.num_shards)}
            if set(checksums) != expected or not all(isinstance(value, str) for value in checksums.values()):
                raise ValueError("its list of shards is not this dataset's")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise CophyError(f"{path} is damaged ({error}): delete it and run `{self.command}`") from error
        return dict(checksums)

    def verify(self, shard: int, checksum: str | None) -> None:
        """Raise DamagedShardError unless the shard is there, has the checksum (if one is known) and is whole."""
        path = self.path(shard)
        try:
            found = None if checksum is None else sha256(path)
        except OSError as error:
            raise DamagedShardError(error.strerror or str(error)) from error
        if found != checksum:
            raise DamagedShardError(f"its checksum is not the one in {MANIFEST}")
        self.check(path, shard)

    def is_finished(self) -> bool:
        """Whether generation came to its end and every shard is still there; reading checks what is in them."""
        return self.checksums() is not None and all(self.path(shard).exists() for shard in range(self.spec.num_shards))

    def finished_checksums(self) -> dict[str, str]:
        """The checksums of a finished set; an unfinished one is an error that names the remedy."""
        checksums = self.checksums()
        if checksums is None:
            raise CophyError(f"{self.directory} is not finished: run `{self.command}`")
        return checksums

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

    def write_manifest(self) -> None:
        """Vouch for a finished set."""
        manifest = {
            **self.description(),
            "versions": {name: _version(name) for name in VERSIONS},
            "shards": {self.path(shard).name: sha256(self.path(shard)) for shard in range(self.spec.num_shards)},
        }
        write_atomically(self.directory / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def dataset_in(file: h5py.File, name: str, shape: tuple[int, ...], dtype: str) -> h5py.Dataset:
    """An array stored in this very file, of this shape and type; anything else is damage, and is not read."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise DamagedShardError(f"'{name}' is missing or points elsewhere")
    array = file[name]
    if not isinstance(array, h5py.Dataset) or array.is_virtual or array.external:
        raise DamagedShardError(f"'{name}' is not an array stored in this file")
    if array.shape != shape or array.dtype != np.dtype(dtype):
        raise DamagedShardError(f"'{name}' is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}")
    return array


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
