"""manifest.json: what a finished set of shards is, with which versions it was made, and a SHA-256 per shard."""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from cophy.atomic_files import read_plain, sha256, write_atomically

MANIFEST = "manifest.json"
VERSIONS = ("cophy", "numpy", "pybullet", "h5py", "hdf5plugin", "opencv-python-headless")  # that bytes may depend on


class DamagedManifestError(Exception):
    """The file is not the manifest of its set; the message says why."""


def read_checksums(directory: Path, shards: Sequence[str]) -> dict[str, str] | None:
    """SHA-256 per shard as the manifest has them, or None where there is no manifest yet.

    Raises:
        DamagedManifestError: it is no manifest of these shards.
    """
    path = directory / MANIFEST
    if not path.exists():
        return None
    try:
        checksums = json.loads(read_plain(path))["shards"]
        if set(checksums) != set(shards) or not all(isinstance(value, str) for value in checksums.values()):
            raise ValueError("its list of shards is not this dataset's")
    except OSError as error:
        raise DamagedManifestError(error.strerror) from error
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
