"""Cost and size of pictures: python benchmarks/images.py. Two twin pairs per scenario at 448 × 448, all modalities.

CPU time of one core. Lossless is proven by drawing again and comparing every pixel with what was stored.
"""

import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from physics import scenario
from rich.console import Console
from rich.table import Table

from cophy import config
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.states import States
from cophy.scenario.rendering import MODALITIES, Backend, Renderer, RenderSettings
from cophy.training.pictures import render_sequence

NUM_OBJECTS = {"blocktower": 3, "balls": 4, "collision": 2}
RENDER = RenderSettings(list(MODALITIES), 448, Backend.tiny)
NUM_EXPERIMENTS = 4
NUM_READ = 200


def main() -> None:
    """Measure, then print."""
    config.register()
    table = Table("scenario", "KiB per experiment: RGB", "depth", "segmentation", "frames/s written", "of which camera",
                  "frames/s read at random", "all pixels as drawn")  # fmt: skip
    with tempfile.TemporaryDirectory() as data_dir:
        for name, count in NUM_OBJECTS.items():
            size = Size("bench", NUM_EXPERIMENTS, {name: {str(count): NUM_EXPERIMENTS}})
            table.add_row(
                name, *measure(Images(States(DatasetSpec(scenario(name), count, size, 0), Path(data_dir)), RENDER))
            )
    Console().print(table)


def measure(images: Images) -> list[str]:
    """One scenario."""
    for shards in (images.states, images):
        shards.directory.mkdir(parents=True, exist_ok=True)
        start = time.process_time()
        took = shards.write(shards.path(0), 0, lambda done: None)
        seconds = time.process_time() - start
        shards.write_manifest()
    num_frames = NUM_EXPERIMENTS * 2 * images.spec.scenario.clock.num_frames
    camera = took["CPU-s inside PyBullet's camera"]
    with h5py.File(images.path(0), "r") as file:
        sizes = [f"{file[name].id.get_storage_size() / NUM_EXPERIMENTS / 1024:.0f}" for name in MODALITIES]
        rng = np.random.default_rng(0)
        start = time.process_time()
        for _ in range(NUM_READ):
            file["rgb"][rng.integers(NUM_EXPERIMENTS), rng.integers(2), rng.integers(30)]
        reading = (time.process_time() - start) / NUM_READ
        same = all(
            np.array_equal(file[name][experiment, sequence], getattr(drawn, name))
            for experiment, sequence, drawn in draw_again(images)
            for name in MODALITIES
        )
    return [
        *sizes,
        f"{num_frames / seconds:.1f}",
        f"{camera / seconds:.0%}",
        f"{1 / reading:.0f}",
        "yes" if same else "NO",
    ]


def draw_again(images: Images):
    """Every sequence, by a renderer that drew nothing before."""
    arrays = images.states.load()
    for experiment in range(NUM_EXPERIMENTS):
        for sequence in (0, 1):
            with Renderer(images.spec.scenario, RENDER.resolution) as renderer:
                yield experiment, sequence, render_sequence(renderer, arrays, experiment, sequence, slice(None))


if __name__ == "__main__":
    main()
