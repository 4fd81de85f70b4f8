"""Files shard-00000.h5 ... of one directory: made whole, vouched for by a manifest, and read safely.

Arrays of a shard: what they look like, and how they are written to an HDF5 file and read from one safely.
manifest.json: what a finished set of shards is, with which versions it was made, and a SHA-256 per shard.
"""

import errno
import io
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from cophy.atomic_files import read_plain, sha256, write_atomically
from cophy.dataset.features import Arrays
from cophy.errors import CophyError
from cophy.scenario import Scenario

OLDEST_FORMAT = ("v110", "v110")  # of HDF5: pinned, so that bytes depend on no library version


class DamagedShardError(Exception):
    """A file is not a whole shard of its set; the message says what is wrong with it."""


@dataclass(frozen=True)
class Field:
    """An array of a shard.

    shape: of the whole array. dtype: as NumPy writes it.
    storage: how HDF5 stores it (chunks, filters), as keywords of `h5py.Group.create_dataset`.
    axes, unit, meaning: for people; the file holds them as attributes of the array. unit: empty where there is none.
    """

    shape: tuple[int, ...]
    dtype: str
    storage: Mapping[str, Any] = field(default_factory=dict)
    axes: str = ""
    unit: str = ""
    meaning: str = ""

    def attributes(self) -> dict[str, str]:
        """What the file says of the array."""
        said = {"axes": self.axes, "unit": self.unit, "meaning": self.meaning}
        return {name: text for name, text in said.items() if text}


Fields = Mapping[str, Field]  # by the name of the array, in the order in which a file stores them


def empty_arrays(fields: Fields) -> dict[str, np.ndarray]:
    """Arrays of zeros to be filled."""
    return {name: np.zeros(field.shape, field.dtype) for name, field in fields.items()}


def encode(arrays: Mapping[str, np.ndarray], fields: Fields, attributes: Mapping[str, str]) -> bytes:
    """The bytes of a file; equal arrays give equal bytes, because no time is stored.

    Args:
        arrays: of the file.
        fields: of its arrays.
        attributes: of the file.
    """
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=OLDEST_FORMAT) as file:
        file.attrs.update(attributes)
        for name, field in fields.items():
            array = file.create_dataset(name, data=arrays[name], track_times=False, **field.storage)
            array.attrs.update(field.attributes())
    return buffer.getvalue()


@contextmanager
def creating(path: Path, fields: Fields, attributes: Mapping[str, str]) -> Iterator[dict[str, h5py.Dataset]]:
    """Create a file whose arrays are filled part by part: they may be larger than the memory.

    Args:
        path: of the file.
        fields: of its arrays.
        attributes: of the file.

    Raises:
        OSError: The disk is full.
    """
    try:
        with h5py.File(path, "w", libver=OLDEST_FORMAT) as file:
            file.attrs.update(attributes)
            arrays = {
                name: file.create_dataset(name, field.shape, field.dtype, track_times=False, **field.storage)
                for name, field in fields.items()
            }
            for name, field in fields.items():
                arrays[name].attrs.update(field.attributes())
            yield arrays
    except RuntimeError as error:  # of HDF5, where it cannot write at the end what it still holds
        if f"errno = {errno.ENOSPC}," in str(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise


@contextmanager
def reading(path: Path, fields: Fields, attributes: Mapping[str, str]) -> Iterator[dict[str, h5py.Dataset]]:
    """Open a file and find its arrays, without reading them.

    Only plain arrays of the expected shape and type are accepted, and attributes of the expected value.

    Args:
        path: of the file.
        fields: of its arrays.
        attributes: of the file.

    Raises:
        DamagedShardError: The file is missing arrays, is truncated, or holds something else; also while arrays are read.
        OSError: The operating system refuses access (permission, input/output error); nothing is known about the file.
    """
    with _open_hdf5(path) as file:
        if any(_attribute_in(file, name) != value for name, value in attributes.items()):
            raise DamagedShardError("it was made from other files than those next to it")
        yield {name: _array_in(file, name, field) for name, field in fields.items()}


def open_for_reading(path: Path) -> h5py.File:
    """Open an HDF5 file, without a lock if the file system has none or the process has the file open without one.

    A process can open a file only with one kind of locking. Users who open a shard with h5py have its default, so that comes
    first.
    """
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if error.errno is None and "locking" not in str(error):
            raise
        return h5py.File(path, "r", locking=False)


@contextmanager
def _open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading; errors that HDF5 finds in it become DamagedShardError.

    Errors of the operating system have an `errno` and pass through: a file must not be replaced because of them.
    """
    check_plain(path)
    try:
        with open_for_reading(path) as file:
            yield file
    except (OSError, KeyError, RuntimeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise DamagedShardError(" ".join(str(error).split())) from error


def check_plain(path: Path) -> None:
    """Raise DamagedShardError for a path that is not a regular file: opening a pipe would block forever."""
    if path.exists() and not path.is_file():
        raise DamagedShardError("it is no plain file")


def _array_in(file: h5py.File, name: str, field: Field) -> h5py.Dataset:
    """An array that is stored in this very file; a link to another place is damage, and is not followed."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise DamagedShardError(f"'{name}' is missing or points elsewhere")
    array = file[name]
    if not isinstance(array, h5py.Dataset) or array.is_virtual or array.external:
        raise DamagedShardError(f"'{name}' is not an array stored in this file")
    try:
        dtype = array.dtype
    except TypeError as error:
        raise DamagedShardError(f"'{name}': {error}") from error
    if array.shape != field.shape or dtype != np.dtype(field.dtype):
        expected = f"{np.dtype(field.dtype)} {field.shape}"
        raise DamagedShardError(f"'{name}' is {dtype} {array.shape}, expected {expected}")
    return array


def _attribute_in(file: h5py.File, name: str) -> str | None:
    """An attribute that is a text; None for what is none."""
    try:
        found = file.attrs.get(name)
    except (TypeError, ValueError):  # of a type that NumPy does not know
        return None
    return found if isinstance(found, str) else None


def attribute(path: Path, name: str) -> str | None:
    """An attribute of a file, or None where it has none that is a text.

    Raises:
        DamagedShardError: The file is not an HDF5 file.
    """
    with _open_hdf5(path) as file:
        return _attribute_in(file, name)


MANIFEST = "manifest.json"
VERSIONS = ("cophy", "numpy", "pybullet", "h5py", "hdf5plugin", "opencv-python-headless")  # that bytes may depend on


class DamagedManifestError(Exception):
    """The file is not the manifest of its set; the message says why."""


def read_checksums(directory: Path, shards: Sequence[str]) -> dict[str, str] | None:
    """SHA-256 per shard as the manifest has them, or None where there is no manifest yet.

    Raises:
        DamagedManifestError: The file is not a manifest of these shards.
        OSError: The operating system refuses access to it.
    """
    path = directory / MANIFEST
    if not path.exists():
        return None
    if not path.is_file():
        raise DamagedManifestError("it is no plain file")
    try:
        checksums = json.loads(read_plain(path))["shards"]
        if set(checksums) != set(shards) or not all(isinstance(value, str) for value in checksums.values()):
            raise ValueError("its list of shards is not this dataset's")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedManifestError(str(error)) from error
    return dict(checksums)


def read_format(directory: Path) -> int | None:
    """The version of the format that a dataset says it has, or None where it does not say."""
    try:
        found = json.loads(read_plain(directory / MANIFEST))["configuration"]["format"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return found if isinstance(found, int) else None


def write_manifest(directory: Path, shards: Sequence[str], description: Mapping[str, Any]) -> None:
    """Vouch for a finished set.

    Args:
        directory: where the shards lie.
        shards: names of all their files.
        description: what the manifest says besides versions and checksums.
    """
    manifest = {
        **description,
        "versions": {name: _version(name) for name in VERSIONS},
        "shards": {name: sha256(directory / name) for name in shards},
    }
    write_atomically(directory / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


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
            if isinstance(error, OSError) and error.errno not in (None, errno.ENOENT):
                raise  # the operating system refuses access: nothing is known about the shard
            raise CophyError(
                f"{self.path(shard)} is damaged ({error}): run `{self.command}` to make it again"
            ) from error

    def _paths(self) -> list[Path]:
        return [self.path(shard) for shard in range(self.spec.num_shards)]

    def _compare(self, shard: int, checksum: str | None) -> None:
        check_plain(self.path(shard))
        if checksum is not None and sha256(self.path(shard)) != checksum:
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
