"""Shards: files shard-00000.h5, ... of one directory that hold the arrays of a dataset, and their manifest.json.

`Field` describes an array of a shard, `encode` and `create_file` write a shard, `open_file` reads one safely, and a `ShardSet` is
a directory of shards. Its manifest names the configuration, the versions of libraries and a SHA-256 per shard.
"""

import errno
import io
import json
import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

import h5py
import hdf5plugin
import numpy as np

from cophy.atomic_files import read_json, sha256, write_atomically
from cophy.errors import CophyError
from cophy.scenario import Scenario

OLDEST_FORMAT = ("v110", "v110")  # of HDF5: pinned, so that bytes do not depend on the version of the library
IDENTITY = "shard"  # attribute of a file: its dataset and its number
MANIFEST = "manifest.json"
VERSIONS = ("cophy", "numpy", "pybullet", "h5py", "hdf5plugin", "opencv-python-headless")  # bytes may depend on these

MAX_FLOAT = float(np.finfo(np.float32).max)
ZSTD_MAGIC, ZSTD_HEADER = b"\x28\xb5\x2f\xfd", 18  # largest size of a header, bytes

Arrays = dict[str, np.ndarray]  # by name; the first axis is the experiment


class DamagedShardError(Exception):
    """A file is not an intact shard of its set; the message says what is wrong with it."""


@dataclass(frozen=True)
class Field:
    """An array of a shard.

    shape: of the whole array. dtype: as NumPy writes it.
    axes, meaning, unit: a description, stored as attributes of the array. unit: empty if there is none.
    storage: how HDF5 stores it (chunks, filters), as keywords of `h5py.Group.create_dataset`.
    limits: the smallest and the largest valid value. may_be_nan: whether NaN marks an unknown value.
    """

    shape: tuple[int, ...]
    dtype: str
    axes: str = ""
    meaning: str = ""
    unit: str = ""
    storage: Mapping[str, Any] = field(default_factory=dict)
    limits: tuple[float, float] = (-MAX_FLOAT, MAX_FLOAT)
    may_be_nan: bool = False

    def attributes(self) -> dict[str, str]:
        """Return the description of the array, as the file stores it."""
        description = {"axes": self.axes, "unit": self.unit, "meaning": self.meaning}
        return {name: text for name, text in description.items() if text}


Fields = Mapping[str, Field]  # by the name of the array, in the order in which a file stores them


def empty_arrays(fields: Fields) -> Arrays:
    """Return arrays of zeros."""
    return {name: np.zeros(field.shape, field.dtype) for name, field in fields.items()}


def encode(arrays: Mapping[str, np.ndarray], fields: Fields, attributes: Mapping[str, str]) -> bytes:
    """Return the bytes of a file with these arrays and attributes; equal arrays give equal bytes, because no time is stored."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=OLDEST_FORMAT) as file:
        file.attrs.update(attributes)
        for name, field in fields.items():
            array = file.create_dataset(name, data=arrays[name], track_times=False, **field.storage)
            array.attrs.update(field.attributes())
    return buffer.getvalue()


@contextmanager
def create_file(path: Path, fields: Fields, attributes: Mapping[str, str]) -> Iterator[dict[str, h5py.Dataset]]:
    """Create a file whose arrays are filled step by step: they may be larger than the memory.

    Raises:
        OSError: It cannot be written.
    """
    try:
        file = h5py.File(path, "w", libver=OLDEST_FORMAT, locking=False)  # some file systems have no locks
        try:
            file.attrs.update(attributes)
            arrays = {
                name: file.create_dataset(name, field.shape, field.dtype, track_times=False, **field.storage)
                for name, field in fields.items()
            }
            for name, field in fields.items():
                arrays[name].attrs.update(field.attributes())
            yield arrays
            file.flush()
        except BaseException:  # nobody will read the file, and HDF5 may crash if it cannot write while it closes one
            with open(os.devnull, "r+b") as nowhere, suppress(RuntimeError):
                os.dup2(nowhere.fileno(), file.id.get_vfd_handle())
                file.close()
            raise
        file.close()
    except (OSError, RuntimeError) as error:
        if number := re.search(r"errno = (\d+)", str(error)):  # in several lines of text of HDF5
            raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from error
        raise


@contextmanager
def open_file(path: Path, fields: Fields, attributes: Mapping[str, str]) -> Iterator[dict[str, h5py.Dataset]]:
    """Open a file and yield its arrays, without reading them.

    Only arrays of the expected shape, type, chunks and filters that are stored in this file are accepted, and no chunk that
    may unpack to gigabytes. An attribute that the file has must have the expected value.

    Raises:
        DamagedShardError: The file is truncated, lacks arrays or holds something else; also while arrays are read.
        OSError: The operating system refuses access (permission, input/output error); nothing is known about the file.
    """
    check_plain(path)
    try:
        with _Reader(path) as reader, h5py.File(reader, "r") as file:
            try:
                if file.userblock_size:
                    raise DamagedShardError("it begins with other content")
                for name in attributes.keys() & file.attrs.keys():
                    if (value := str(file.attrs[name])) != attributes[name]:
                        raise DamagedShardError(
                            f"it belongs to other data: its {name} is {value}, not {attributes[name]}"
                        )
                arrays = {name: _array_in(file, reader, name, field) for name, field in fields.items()}
            except (KeyError, TypeError, ValueError) as error:  # types that NumPy does not have, broken objects
                raise DamagedShardError(str(error)) from error
            yield arrays
    except (OSError, RuntimeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # the operating system's, which says nothing about the content: the file is kept
        raise DamagedShardError(" ".join(str(error).split())) from error


def open_for_reading(path: Path) -> h5py.File:
    """Open an HDF5 file without a lock. Errors of the operating system have an errno and name the file, others have none."""
    return h5py.File(_Reader(path), "r")


class _Reader(io.RawIOBase):
    """A file that HDF5 reads through Python; processes that inherit it share no position."""

    def __init__(self, path: Path) -> None:
        self._path, self._descriptor, self._position = path, os.open(path, os.O_RDONLY), 0

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        size = os.fstat(self._descriptor).st_size
        self._position = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: size}[whence]
        return self._position

    def readinto(self, buffer: Any) -> int:
        content = self.read_at(self._position, len(buffer))
        buffer[:] = content
        return len(content)

    def read_at(self, position: int, count: int) -> bytes:
        """Return this many bytes."""
        try:
            content = os.pread(self._descriptor, count, position)
        except OSError as error:
            error.filename = str(self._path)
            raise
        if len(content) < count:
            raise DamagedShardError("it is truncated")
        return content

    def close(self) -> None:
        if not self.closed:
            os.close(self._descriptor)
        super().close()


def check_plain(path: Path) -> None:
    """Raise DamagedShardError for a path that is not a regular file: opening a pipe would block forever."""
    if path.exists() and not path.is_file():
        raise DamagedShardError("it is not a regular file")


def _array_in(file: h5py.File, reader: _Reader, name: str, field: Field) -> h5py.Dataset:
    """Return an array that is stored in this very file; links to other places are not followed."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise DamagedShardError(f"'{name}' is missing or points elsewhere")
    array = file[name]
    if not isinstance(array, h5py.Dataset) or array.is_virtual or array.external:
        raise DamagedShardError(f"'{name}' is not an array stored in this file")
    if array.shape != field.shape or array.dtype != np.dtype(field.dtype):
        expected = f"{np.dtype(field.dtype)} {field.shape}"
        raise DamagedShardError(f"'{name}' is {array.dtype} {array.shape}, expected {expected}")
    if (storage := _storage_of(array)) != (expected_storage := _expected_storage(field)):
        raise DamagedShardError(f"'{name}' has {storage}, expected {expected_storage}")
    if array.chunks is not None:
        _check_chunks(array, reader)
    return array


def _storage_of(array: h5py.Dataset) -> str:
    return f"chunks {array.chunks} and filters {_filters(array)}"


def _filters(array: h5py.Dataset) -> list[int]:
    """Return the numbers of the filters of an array, as HDF5 registers them."""
    properties = array.id.get_create_plist()
    return [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]


def _expected_storage(field: Field) -> str:
    if not field.storage:
        return "chunks None and filters []"
    with h5py.File(io.BytesIO(), "w") as file:
        return _storage_of(file.create_dataset("array", field.shape, field.dtype, **field.storage))


def _check_chunks(array: h5py.Dataset, reader: _Reader) -> None:
    """Refuse chunks that may unpack to far more than their size, before one is read.

    Deflate unpacks to at most 1032 times the stored size, which must not exceed the size of the chunk. Zstd has no such limit,
    but its frames begin with the unpacked size, and HDF5 unpacks no more than that.
    """
    size, num_chunks = math.prod(array.chunks) * array.dtype.itemsize, 0
    most = size + size // 100 + 64  # ours: more than compression and a checksum add
    is_zstd = hdf5plugin.ZSTD_ID in _filters(array)

    def check(chunk: h5py.h5d.StoreInfo) -> None:
        nonlocal num_chunks
        num_chunks += 1
        head = reader.read_at(chunk.byte_offset, min(chunk.size, ZSTD_HEADER)) if is_zstd else b""
        if chunk.size > most or (is_zstd and _zstd_size(head) != size):
            raise DamagedShardError(f"'{array.name[1:]}' has a chunk that does not unpack to {size} bytes")
        if num_chunks > math.prod(map(math.ceil, np.divide(array.shape, array.chunks))):
            raise DamagedShardError(f"'{array.name[1:]}' has too many chunks")

    array.id.chunk_iter(check)


def _zstd_size(head: bytes) -> int | None:
    """Return the unpacked size that the beginning of a Zstd frame declares (RFC 8878), None where it declares none."""
    if len(head) < ZSTD_HEADER or head[:4] != ZSTD_MAGIC:
        return None
    flags = head[4]
    is_single, start = flags >> 5 & 1, 5 + (0, 1, 2, 4)[flags & 3]
    start, width = start + 1 - is_single, (is_single, 2, 4, 8)[flags >> 6]
    return int.from_bytes(head[start : start + width], "little") + (256 if width == 2 else 0) if width else None


def _invalid_values(arrays: Arrays, fields: Fields) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what is wrong with the values of an array, and with which experiments, (experiment,) bool."""
    for name, expected in fields.items():
        (low, high), values = expected.limits, arrays[name]
        if values.dtype.kind == "S":
            continue
        if values.dtype.kind == "b":  # HDF5 does not check that they are 0 or 1
            low, high, values = 0, 1, values.view(np.uint8)
        valid = (values >= low) & (values <= high)
        if expected.may_be_nan:
            valid |= np.isnan(values)
        if not valid.all():
            yield f"{name} holds {values[~valid][0]:g}", np.asarray(~valid.reshape(len(values), -1).all(axis=1))


class Sharded(Protocol):
    """Experiments in an order, some number of them per file."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def num_objects(self) -> int: ...

    @property
    def num_experiments(self) -> int: ...

    @property
    def num_shards(self) -> int: ...

    def experiments_of_shard(self, shard: int) -> range:
        """Return the indices of the experiments in a shard."""


class ShardSet(ABC):
    """Arrays of all experiments of a dataset, in shards of one directory: a pure function of a configuration.

    A subclass defines the fields of a shard, how a shard is written, and from which other files.

    title: what it contains, for messages. command: generates, continues or repairs it.
    slow_hint: the end of the warning that no experiment is done after a while.
    """

    slow_hint = ""
    place: PurePosixPath | None = None  # below a data directory, where there may be a copy of it elsewhere

    def __init__(self, spec: Sharded, directory: Path, *, title: str, command: str) -> None:
        self.spec, self.directory, self.title, self.command = spec, directory, title, command

    @abstractmethod
    def fields(self, shard: int) -> Fields:
        """Return the fields of a shard."""

    @abstractmethod
    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Write one shard.

        Args:
            shard: Its number.
            advance: Called with the number of experiments that were just completed.

        Returns:
            The cost of it, by unit, to be logged.
        """

    def experiments(self, shard: int) -> Sequence[int]:
        """Return the experiments in a shard, all of which `write` reports through `advance`."""
        return self.spec.experiments_of_shard(shard)

    def cost(self, experiments: int) -> tuple[float, float]:
        """Return an estimate for this many experiments: CPU-seconds and MB on disk; zeros where nothing was measured."""
        return 0.0, 0.0

    def invalid(self, arrays: Arrays, shard: int) -> Iterator[tuple[str, np.ndarray]]:
        """Yield what is wrong with the values in a shard, and with which of its experiments, (experiment,) bool."""
        yield from _invalid_values(arrays, self.fields(shard))

    @abstractmethod
    def description(self) -> dict[str, Any]:
        """Return what the manifest contains besides versions and checksums."""

    def input_checksums(self, shard: int) -> dict[str, str]:
        """Return the SHA-256 of the files that a shard is computed from, as attributes of its file."""
        return {}

    def attributes(self, shard: int) -> dict[str, str]:
        """Return the attributes of a file: which shard of which set it is, and the files it is computed from."""
        return {IDENTITY: f"{self.directory.name}/{shard}", **self.input_checksums(shard)}

    def check(self, shard: int) -> None:
        """Read everything; raise DamagedShardError if the file is not what this set expects."""
        self._read(shard)

    def path(self, shard: int) -> Path:
        """Return the file of a shard."""
        return self.directory / f"shard-{shard:05d}.h5"

    def paths(self) -> list[Path]:
        """Return the files of all shards."""
        return [self.path(shard) for shard in range(self.spec.num_shards)]

    def is_finished(self) -> bool:
        """Return whether there is a manifest and every shard exists; their content is checked when they are read."""
        return self.checksums() is not None and all(path.exists() for path in self.paths())

    def checksums(self) -> dict[str, str] | None:
        """Return the SHA-256 per shard in the manifest, or None if there is no manifest yet."""
        path, names = self.directory / MANIFEST, {path.name for path in self.paths()}
        if not path.exists():
            return None
        try:
            checksums = read_json(path).get("shards")
        except ValueError:
            checksums = None
        if not isinstance(checksums, dict) or checksums.keys() != names or set(map(type, checksums.values())) != {str}:
            raise CophyError(f"{path} is damaged: it has no SHA-256 of each shard. Delete it and run `{self.command}`")
        return checksums

    def finished_checksums(self) -> dict[str, str]:
        """Return the checksums of a finished set; an unfinished one is an error that names the remedy."""
        checksums = self.checksums()
        if checksums is None:
            raise CophyError(f"{self.directory} is not finished: run `{self.command}`")
        return checksums

    def checksum(self, shard: int) -> str:
        """Return the SHA-256 of a shard of a finished set."""
        return self.finished_checksums()[self.path(shard).name]

    def verify(self, shard: int, checksum: str | None) -> None:
        """Raise DamagedShardError unless the shard exists, has this checksum (if it is known) and is what this set expects."""
        self._compare(shard, checksum)
        self.check(shard)

    def read(self, shard: int) -> Arrays:
        """Return the arrays of one shard of a finished set, checked against its checksum."""
        return self._verified(shard, self.checksum(shard))

    def load(self, reduce: Callable[[Arrays], Arrays] = lambda arrays: arrays) -> Arrays:
        """Return the arrays of all experiments in order; every shard is checked against its checksum.

        Args:
            reduce: Applied to the arrays of each shard before they are joined, to save memory.
        """
        checksums = self.finished_checksums()
        shards = [reduce(self._verified(shard, checksums[path.name])) for shard, path in enumerate(self.paths())]
        return {name: np.concatenate([arrays[name] for arrays in shards]) for name in shards[0]}

    def open(self, shard: int) -> AbstractContextManager[dict[str, h5py.Dataset]]:
        """Open a shard and yield its arrays, without reading them."""
        return open_file(self.path(shard), self.fields(shard), self.attributes(shard))

    def write_manifest(self, versions: Mapping[str, str] | None = None) -> None:
        """Write the manifest of a finished set; `versions` are those of the libraries that wrote it, by default today's."""
        manifest = {
            **self.description(),
            "versions": versions or {name: _version(name) for name in VERSIONS},
            "shards": {path.name: sha256(path) for path in self.paths()},
        }
        write_atomically(self.directory / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())

    def max_bytes(self, shard: int) -> int:
        """Return the largest size of a file; ours: twice that of its arrays, and room for what describes them."""
        arrays = self.fields(shard).values()
        return 2 * sum(math.prod(each.shape) * np.dtype(each.dtype).itemsize for each in arrays) + (1 << 20)

    @contextmanager
    def report_damage(self, shard: int) -> Iterator[None]:
        """Turn damage found while reading a shard into an error that names the file and the remedy."""
        try:
            yield
        except (DamagedShardError, OSError) as error:
            if isinstance(error, OSError) and error.errno not in (None, errno.ENOENT):
                raise  # the operating system refuses access: nothing is known about the shard
            raise CophyError(
                f"{self.path(shard)} is damaged ({error}): run `{self.command}` to generate it again"
            ) from error

    def _compare(self, shard: int, checksum: str | None) -> None:
        path, most = self.path(shard), self.max_bytes(shard)
        check_plain(path)
        if path.stat().st_size > most:
            raise DamagedShardError(f"it has more than {most} bytes")
        if checksum is not None and sha256(path) != checksum:
            raise DamagedShardError(f"its checksum is not the one in {MANIFEST}")

    def _verified(self, shard: int, checksum: str) -> Arrays:
        with self.report_damage(shard):
            self._compare(shard, checksum)
            return self._read(shard)

    def _read(self, shard: int) -> Arrays:
        with self.open(shard) as stored:
            arrays = {name: np.asarray(array[()]) for name, array in stored.items()}
        for problem, rows in self.invalid(arrays, shard):
            if rows.any():
                raise DamagedShardError(f"experiment {self.experiments(shard)[int(rows.argmax())]}: {problem}")
        return arrays


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
