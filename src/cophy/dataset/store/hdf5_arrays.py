"""Arrays of a shard: what they look like, and how they are written to an HDF5 file and read from one safely."""

import errno
import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

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
        DamagedShardError: something is missing, cut off, or not what was expected, also while arrays are read.
    """
    check_plain(path)
    try:
        with h5py.File(path, "r") as file:
            if any(_attribute_in(file, name) != value for name, value in attributes.items()):
                raise DamagedShardError("it was made of other files than those beside it")
            yield {name: _array_in(file, name, field) for name, field in fields.items()}
    except (OSError, KeyError, RuntimeError) as error:
        raise DamagedShardError(" ".join(str(error).split())) from error


def check_plain(path: Path) -> None:
    """Before a file is opened: to open a pipe would wait for ever.

    Raises:
        DamagedShardError: it is there, and no plain file.
    """
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
        DamagedShardError: it is no HDF5 file.
    """
    check_plain(path)
    try:
        with h5py.File(path, "r") as file:
            return _attribute_in(file, name)
    except (OSError, RuntimeError) as error:
        raise DamagedShardError(" ".join(str(error).split())) from error
