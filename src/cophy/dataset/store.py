"""A dataset's directory: shards, the manifest that vouches for them, and reading them back."""

import hashlib
import json
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from cophy.dataset.shard import DamagedShardError, decode
from cophy.dataset.spec import DatasetSpec
from cophy.errors import CophyError

MANIFEST = "manifest.json"


def shard_path(directory: Path, shard: int) -> Path:
    """File of a shard."""
    return directory / f"shard-{shard:05d}.h5"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: temporary name, flush, rename."""
    temporary = path.with_name(f"{path.name}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_manifest(directory: Path, spec: DatasetSpec) -> None:
    """Vouch for a finished dataset: configuration, versions, counts and the SHA-256 of every shard."""
    paths = [shard_path(directory, shard) for shard in range(spec.num_shards)]
    manifest = {
        "id": spec.id,
        "configuration": spec.generating_configuration(),
        "strata": list(spec.scenario.strata()),
        "versions": {name: _version(name) for name in ("cophy", "numpy", "pybullet", "h5py")},
        "shards": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths},
    }
    write_atomically(directory / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def read_checksums(directory: Path, spec: DatasetSpec) -> dict[str, str] | None:
    """SHA-256 per shard as the manifest has them, or None where there is no manifest yet."""
    path = directory / MANIFEST
    if not path.exists():
        return None
    try:
        checksums = json.loads(path.read_bytes())["shards"]
        expected = {shard_path(directory, shard).name for shard in range(spec.num_shards)}
        if set(checksums) != expected or not all(isinstance(value, str) for value in checksums.values()):
            raise ValueError("its list of shards is not this dataset's")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CophyError(f"{path} is damaged ({error}): delete it and run `{spec.command(directory)}`") from error
    return dict(checksums)


def read_shard(directory: Path, shard: int, spec: DatasetSpec, checksum: str | None) -> dict[str, np.ndarray]:
    """The arrays of one shard; raises DamagedShardError unless it is whole and has the checksum (if one is known)."""
    try:
        content = shard_path(directory, shard).read_bytes()
    except OSError as error:
        raise DamagedShardError(error.strerror or str(error)) from error
    if checksum is not None and hashlib.sha256(content).hexdigest() != checksum:
        raise DamagedShardError(f"its checksum is not the one in {MANIFEST}")
    return decode(content, shard, spec)


def is_finished(directory: Path, spec: DatasetSpec) -> bool:
    """Whether generation came to its end and every shard is still there; `load` checks what is in them."""
    if read_checksums(directory, spec) is None:
        return False
    return all(shard_path(directory, shard).exists() for shard in range(spec.num_shards))


def load(directory: Path, spec: DatasetSpec) -> dict[str, np.ndarray]:
    """All arrays of a finished dataset, experiments in order; every shard is checked against its checksum."""
    checksums = read_checksums(directory, spec)
    if checksums is None:
        raise CophyError(f"{directory} holds no finished dataset: run `{spec.command(directory)}`")
    shards = []
    for shard in range(spec.num_shards):
        path = shard_path(directory, shard)
        try:
            shards.append(read_shard(directory, shard, spec, checksums[path.name]))
        except DamagedShardError as error:
            raise CophyError(
                f"{path} is damaged ({error}): run `{spec.command(directory)}` to make it again"
            ) from error
    return {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0]}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
