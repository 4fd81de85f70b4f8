"""Shards: only arrays of the expected shape are read, and nothing is read without an intact manifest."""

import errno
import fcntl
import json
import os
import zlib
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
import pytest

from cophy.atomic_files import sha256
from cophy.dataset.shards import MANIFEST, DamagedShardError, Field, create_file, encode, open_file, open_for_reading
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.conftest import raising
from tests.dataset.copies import SPEC, copy

FIELDS = {"mass": Field((2, 4), "<f4"), "cell": Field((2,), "|u1")}
UNKNOWN = h5py.h5t.UNIX_D32LE  # a type that NumPy does not have
ARRAYS = {"mass": np.arange(8, dtype="f4").reshape(2, 4), "cell": np.array([3, 1], dtype="u1")}


@pytest.mark.parametrize("fault", ["missing", "external", "soft link", "shape", "type", "opaque", "cut off", "pipe"])
def test_a_file_without_the_expected_arrays_is_damaged(tmp_path: Path, fault: str) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    if fault == "cut off":
        path.write_bytes(path.read_bytes()[:100])
    elif fault == "pipe":
        path.unlink()
        os.mkfifo(path)
    else:
        with h5py.File(path, "r+") as file:
            del file["mass"]
            if fault == "external":
                file["mass"] = h5py.ExternalLink("/etc/passwd", "x")
            elif fault == "soft link":
                file["mass"] = h5py.SoftLink("/cell")
            elif fault == "shape":
                file.create_dataset("mass", shape=(10**9, 4), dtype="f4", chunks=(1000, 4))
            elif fault == "type":
                file.create_dataset("mass", shape=(2, 4), dtype="f8")
            elif fault == "opaque":
                h5py.h5d.create(file.id, b"mass", UNKNOWN, h5py.h5s.create_simple((2, 4)))
    with (
        pytest.raises(DamagedShardError, match=r"truncated|mass|not a regular file|No NumPy equivalent"),
        open_file(path, FIELDS, {}),
    ):
        pass


def test_arrays_have_their_own_names_in_files(tmp_path: Path) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    with h5py.File(path) as file:
        assert set(file) == {"mass", "cell"}
    with open_file(path, FIELDS, {}) as stored:
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(stored[name][()], array)


def test_a_file_of_other_data_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "shard.h5"
    with create_file(path, FIELDS, {"states_sha256": "a"}) as stored:
        stored["mass"][:] = ARRAYS["mass"]
    with open_file(path, FIELDS, {"states_sha256": "a", "images_sha256": "b"}) as stored:
        np.testing.assert_array_equal(stored["mass"][()], ARRAYS["mass"])
    message = "it belongs to other data: its states_sha256 is a, not b"
    with pytest.raises(DamagedShardError, match=message), open_file(path, FIELDS, {"states_sha256": "b"}):
        pass
    for spoil in (lambda file: file.attrs.update(states_sha256=["a", "a"]), with_unknown_attribute):
        with h5py.File(path, "r+") as file:
            spoil(file)
        with pytest.raises(DamagedShardError), open_file(path, FIELDS, {"states_sha256": "a"}):
            pass


def with_unknown_attribute(file: h5py.File) -> None:
    del file.attrs["states_sha256"]
    h5py.h5a.create(file.id, b"states_sha256", UNKNOWN, h5py.h5s.create(h5py.h5s.SCALAR))


def test_an_error_of_the_operating_system_is_not_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    monkeypatch.setattr(h5py, "File", raising(errno.EACCES))
    with pytest.raises(OSError, match=os.strerror(errno.EACCES)), open_file(path, FIELDS, {}):
        pass


def test_files_are_written_and_read_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_without_locks(path: object, mode: str, **options: Any) -> h5py.File:
        if isinstance(path, Path) and options.get("locking") is not False:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
        return file_class(path, mode, **options)

    path, file_class = tmp_path / "shard.h5", h5py.File
    monkeypatch.setattr(h5py, "File", open_without_locks)
    with create_file(path, FIELDS, {}) as stored:
        stored["mass"][:] = ARRAYS["mass"]
    with open(path) as locked, open_file(path, FIELDS, {}) as stored:
        fcntl.flock(locked, fcntl.LOCK_EX)
        np.testing.assert_array_equal(stored["mass"][()], ARRAYS["mass"])


def test_an_error_while_reading_is_not_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    with open_file(path, FIELDS, {}) as stored, monkeypatch.context() as patched:
        patched.setattr(os, "pread", raising(errno.EIO))
        with pytest.raises(OSError, match=r"Input/output error: .*shard\.h5"):
            stored["mass"][()]


def test_processes_share_no_position_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    with open_for_reading(path) as file:
        descriptors = {int(entry.name) for entry in Path("/proc/self/fd").iterdir() if entry.resolve() == path}
        for descriptor in descriptors:  # as another process that has inherited it
            os.lseek(descriptor, 7, os.SEEK_SET)
        np.testing.assert_array_equal(file["mass"][()], ARRAYS["mass"])
        assert descriptors


@pytest.mark.parametrize("content", [b"", b"no HDF5", b"\x89HDF\r\n\x1a\n"])
def test_a_file_that_is_not_hdf5_is_damaged(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(content)
    with pytest.raises(DamagedShardError), open_file(path, FIELDS, {}):
        pass


@pytest.mark.parametrize("locking", [None, False])
def test_a_file_that_its_user_has_open_with_h5py_is_read(tmp_path: Path, locking: bool | None) -> None:
    path = tmp_path / "shard.h5"
    with h5py.File(path, "w") as file:
        file["mass"] = np.arange(3)
    with h5py.File(path, "r", locking=locking), open_for_reading(path) as file:
        np.testing.assert_array_equal(file["mass"], np.arange(3))


@pytest.mark.parametrize("content", ["{", "[" * 100_000, "[]", '{"shards": {}}'])
def test_a_damaged_manifest_is_named_with_its_remedy(finished: Path, tmp_path: Path, content: str) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).write_text(content)
    with pytest.raises(CophyError, match=r"manifest\.json is damaged.* Delete it and run"):
        States(SPEC, tmp_path).load()


def test_a_pipe_instead_of_a_manifest_is_named(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    os.mkfifo(directory / MANIFEST)
    with pytest.raises(OSError, match=r"it is not a regular file: .*manifest\.json"):
        States(SPEC, tmp_path).load()


def test_an_unfinished_dataset_is_not_loaded(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match="is not finished: run"):
        States(SPEC, tmp_path).load()


@pytest.mark.parametrize("name", [MANIFEST, "shard-00001.h5"])
def test_a_huge_file_is_named_at_once(finished: Path, tmp_path: Path, name: str) -> None:
    os.truncate(copy(finished, tmp_path) / name, 2**40)  # a sparse file
    with pytest.raises((CophyError, OSError), match=rf"File too large: .*{name}|{name} is damaged \(it has more than"):
        States(SPEC, tmp_path).load()


CHUNKED = {
    "rgb": Field((4, 8, 8), "|u1", storage={"chunks": (1, 8, 8), "fletcher32": True, **hdf5plugin.Zstd(clevel=3)}),
    "states": Field((4, 64), "<f4", storage={"chunks": (1, 64), "compression": "gzip", "compression_opts": 1}),
}
UNPACKED = 1 << 26  # bytes of a bomb, as few as one megabyte unpacks to in a second


def zstd_bomb(size: int) -> bytes:
    """A frame that declares its size, with blocks that repeat one byte."""
    blocks = [b"\x02\x00\x10\x00"[:3] + b"\x00"] * (size >> 17)
    return b"\x28\xb5\x2f\xfd\xa0" + size.to_bytes(4, "little") + b"".join(blocks)


@pytest.mark.parametrize("fault", ["chunks", "filters", "no filter", "deflate", "zstd", "user block"])
def test_a_chunk_that_unpacks_to_more_is_refused_before_it_is_read(tmp_path: Path, fault: str) -> None:
    path, name = tmp_path / "shard.h5", "rgb" if fault == "zstd" else "states"
    arrays = {name: np.ones(field.shape, field.dtype) for name, field in CHUNKED.items()}
    path.write_bytes(encode(arrays, CHUNKED, {}))
    with open_file(path, CHUNKED, {}) as stored:
        np.testing.assert_array_equal(stored["rgb"][()], arrays["rgb"])
    shape, storage = CHUNKED[name].shape, dict(CHUNKED[name].storage)
    if fault == "user block":
        path.unlink()
        with h5py.File(path, "w", userblock_size=512) as file:
            for each, field in CHUNKED.items():
                file.create_dataset(each, data=arrays[each], **field.storage)
    else:
        with h5py.File(path, "r+") as file:
            del file[name]
            if fault == "chunks":
                file.create_dataset(name, shape, "f4", **{**storage, "chunks": shape})
            elif fault == "filters":
                file.create_dataset(name, shape, "f4", **storage, shuffle=True)
            elif fault == "no filter":
                file.create_dataset(name, shape, "f4")
            else:
                array = file.create_dataset(name, shape, CHUNKED[name].dtype, **storage)
                bomb = zlib.compress(bytes(UNPACKED)) if fault == "deflate" else zstd_bomb(UNPACKED)
                array.id.write_direct_chunk((0,) * len(shape), bomb)
    with pytest.raises(DamagedShardError, match=rf"'{name}' has |other content"), open_file(path, CHUNKED, {}):
        pass


WRONG = [
    *(("states", value) for value in (np.nan, np.inf, 1e38)),
    *(("mass", value) for value in (0.0, -1.0, np.nan)),
    *((name, np.nan) for name in ("friction", "restitution", "gravity")),
    *((name, 100) for name in ("shape", "object_index", "do_operation", "do_slot", "cell", "split")),
    *(("friction", -5.0), ("restitution", 2.0), ("configuration", -1)),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_value_that_no_experiment_has_is_named(finished: Path, tmp_path: Path, name: str, value: float) -> None:
    """The manifest fits, as if the data had been written so."""
    directory, states = copy(finished, tmp_path), States(SPEC, tmp_path)
    with h5py.File(states.path(1), "r+") as file:
        array = file[name][()]
        place = np.argwhere(array[3] != 0)[0] if name == "mass" else [0] * (array.ndim - 1)
        array[(3, *place)] = value
        file[name][...] = array
    manifest = json.loads((directory / MANIFEST).read_text())
    manifest["shards"]["shard-00001.h5"] = sha256(states.path(1))
    (directory / MANIFEST).write_text(json.dumps(manifest))
    experiment = SPEC.experiments_of_shard(1)[3]
    with pytest.raises(CophyError, match=rf"shard-00001\.h5 is damaged \(experiment {experiment}: {name} .*run `"):
        states.load()
