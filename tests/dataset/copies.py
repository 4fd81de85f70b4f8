"""A small generated dataset to be copied, damaged and made again."""

import hashlib
from pathlib import Path

from cophy.dataset import generation
from cophy.dataset.states import States
from tests.conftest import tiny_spec

SPEC = tiny_spec("collision")


def generate(data_dir: Path, workers: int = 2) -> Path:
    """The directory of the dataset, made or repaired."""
    states = States(SPEC, data_dir)
    generation.make(states, workers=workers)
    return states.directory


def digests(directory: Path) -> dict[str, str]:
    """SHA-256 per shard, and of the manifest."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in directory.glob("*.[hj]*")}


def copy(finished: Path, data_dir: Path) -> Path:
    """Shards and manifest of a finished dataset, in another data directory."""
    directory = SPEC.directory(data_dir)
    directory.mkdir(parents=True)
    for path in finished.glob("*.[hj]*"):
        (directory / path.name).write_bytes(path.read_bytes())
    return directory
