"""A small dataset with pictures, to be copied, damaged and drawn again."""

from pathlib import Path

from cophy.dataset.images import Images
from cophy.dataset.states import States
from cophy.scenario.rendering import MODALITIES, Backend, RenderSettings
from tests.dataset.copies import SPEC

RENDER = RenderSettings(list(MODALITIES), 16, Backend.tiny)


def images(data_dir: Path) -> Images:
    """Pictures in a data directory, not yet drawn."""
    return States(SPEC, data_dir).frames(RENDER)


def copy_images(finished: Images, data_dir: Path) -> Images:
    """Shards and manifests of states and pictures, in another data directory."""
    copied = images(data_dir)
    copied.directory.mkdir(parents=True)
    for source, target in (
        (finished.states.directory, copied.states.directory),
        (finished.directory, copied.directory),
    ):
        for path in source.glob("*.[hj]*"):
            (target / path.name).write_bytes(path.read_bytes())
    return copied
