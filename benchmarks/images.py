"""Cost and size of pictures: python benchmarks/images.py. Two twin pairs per scenario at 448 × 448, all modalities.

CPU time of one core. Lossless is proven by drawing again and comparing every pixel with what was stored.
"""

import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
from measure import NUM_OBJECTS, cpu_seconds
from rich.console import Console
from rich.table import Table
from speed_generation import draw, made_states

from cophy.dataset.images import Images
from cophy.drawing.sheets import render_sequence
from cophy.scenario.rendering import MODALITIES, Backend, Frames, Renderer, RenderSettings
from cophy.schemas import register

RENDER = RenderSettings(list(MODALITIES), 448, Backend.tiny)
NUM_EXPERIMENTS = 4
NUM_READ = 200
COLUMNS = (
    *("scenario", "KiB per experiment: RGB", "depth", "segmentation", "frames/s written", "of which camera"),
    *("frames/s read at random", "all pixels as drawn"),
)


def main() -> None:
    """Measure, then print."""
    register()
    table = Table(*COLUMNS)
    with tempfile.TemporaryDirectory() as data_dir:
        for name, count in NUM_OBJECTS.items():
            states = made_states(name, count, NUM_EXPERIMENTS, Path(data_dir), per_shard=NUM_EXPERIMENTS)
            table.add_row(name, *measure(Images(states, RENDER)))
    Console().print(table)


def measure(images: Images) -> list[str]:
    """A row of the table."""
    seconds, camera = draw(images, 0)
    num_frames = NUM_EXPERIMENTS * 2 * images.spec.scenario.clock.num_frames
    with h5py.File(images.path(0), "r") as file:
        sizes = [f"{file[name].id.get_storage_size() / NUM_EXPERIMENTS / 1024:.0f}" for name in MODALITIES]
        reading = cpu_seconds(lambda: read_at_random(file["rgb"])) / NUM_READ
        lossless = all(same(file, experiment, sequence, drawn) for experiment, sequence, drawn in draw_again(images))
    rates = f"{num_frames / seconds:.1f}", f"{camera / seconds:.0%}", f"{1 / reading:.0f}"
    return [*sizes, *rates, "yes" if lossless else "NO"]


def read_at_random(rgb: h5py.Dataset) -> None:
    """NUM_READ frames, one by one."""
    rng = np.random.default_rng(0)
    for _ in range(NUM_READ):
        rgb[tuple(rng.integers(rgb.shape[:3]))]


def same(file: h5py.File, experiment: int, sequence: int, drawn: Frames) -> bool:
    """Whether a sequence was stored as it was drawn.

    Args:
        file: The shard.
        experiment: Of the shard.
        sequence: 0 for AB, 1 for CD.
        drawn: Its frames, drawn again.
    """
    return all(np.array_equal(file[name][experiment, sequence], getattr(drawn, name)) for name in MODALITIES)


def draw_again(images: Images) -> Iterator[tuple[int, int, Frames]]:
    """Every (experiment, sequence, frames), by a renderer that drew nothing before."""
    arrays = images.states.load()
    for experiment in range(NUM_EXPERIMENTS):
        for sequence in (0, 1):
            with Renderer(images.spec.scenario, RENDER.resolution) as renderer:
                yield experiment, sequence, render_sequence(renderer, arrays, experiment, sequence, slice(None))


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
