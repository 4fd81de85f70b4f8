"""Shards: only arrays of the expected shape are read, and nothing is read without an intact manifest."""

import errno
import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from cophy.dataset.shards import MANIFEST, DamagedShardError, Field, create_file, encode, open_file, open_for_reading
from cophy.dataset.states import States
from cophy.errors import CophyError
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
    def fail(*args: object, **kwargs: object) -> None:
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))

    path = tmp_path / "shard.h5"
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    monkeypatch.setattr(h5py, "File", fail)
    with pytest.raises(OSError, match=os.strerror(errno.EACCES)), open_file(path, FIELDS, {}):
        pass


def test_a_file_is_read_where_it_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_without_locks(path: Path, mode: str, locking: bool | None = None) -> h5py.File:
        if locking is not False:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
        return file_class(path, mode, locking=False)

    path, file_class = tmp_path / "shard.h5", h5py.File
    path.write_bytes(encode(ARRAYS, FIELDS, {}))
    monkeypatch.setattr(h5py, "File", open_without_locks)
    with open_file(path, FIELDS, {}) as stored:
        np.testing.assert_array_equal(stored["mass"][()], ARRAYS["mass"])


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
