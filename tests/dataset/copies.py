"""A small dataset and its images, to be copied, damaged and generated again."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from cophy.dataset import generation
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.states import States
from cophy.scenario.rendering import MODALITIES, Backend, RenderSettings
from tests.conftest import tiny_spec

SPEC = tiny_spec("collision")
# fewer experiments, because rendering takes long: the test split has two
IMAGE_SPEC = replace(SPEC, size=Size("tiny", experiments_per_shard=6, num_experiments={"collision": {"2": 12}}))
RENDER = RenderSettings(list(MODALITIES), 16, Backend.tiny)


def generate(data_dir: Path, spec: DatasetSpec = SPEC, workers: int = 1) -> Path:
    """Generate or repair a dataset; return its directory."""
    states = States(spec, data_dir)
    generation.make(states, workers=workers)
    return states.directory


def digests(directory: Path) -> dict[str, str]:
    """Return the SHA-256 of each shard, and of the manifest."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in directory.glob("*.[hj]*")}


def copy(finished: Path, data_dir: Path) -> Path:
    """Copy shards and manifest of a finished dataset to another data directory."""
    directory = data_dir / finished.parent.name / finished.name
    directory.mkdir(parents=True)
    for path in finished.glob("*.[hj]*"):
        (directory / path.name).write_bytes(path.read_bytes())
    return directory


def images(data_dir: Path) -> Images:
    """Return the images of a smaller dataset in a data directory."""
    return States(IMAGE_SPEC, data_dir).frames(RENDER)


def copy_images(finished: Images, data_dir: Path) -> Images:
    """Copy shards and manifests of states and images to another data directory."""
    copy(finished.states.directory, data_dir)
    copied = images(data_dir)
    copied.directory.mkdir()
    for path in finished.directory.glob("*.[hj]*"):
        (copied.directory / path.name).write_bytes(path.read_bytes())
    return copied


def empty(directory: Path) -> None:
    """Remove the files of a directory."""
    for path in directory.iterdir():
        path.unlink()


class MeanColor:
    """A de-renderer that returns the mean of an image as every coordinate and logit."""

    name, source, render = "guess", Path("guess.ckpt"), RENDER

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = rgb.mean(axis=(1, 2, 3))
        return np.broadcast_to(mean[:, None, None], (len(rgb), 4, 3)), np.broadcast_to(mean[:, None], (len(rgb), 4))
