"""Images of a dataset: RGB, depth and segmentation of its states, in shards next to them; all lossless."""

import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np

from cophy.dataset import generation
from cophy.dataset.archive import Files, is_available
from cophy.dataset.cards import write_image_card
from cophy.dataset.experiment_set import (
    ALL_FRAMES,
    ExperimentSet,
    FrameReader,
    NeededFrames,
    ReadImages,
    SequenceFrames,
)
from cophy.dataset.shards import Arrays, Field, Fields, ShardSet, create_file, open_for_reading
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Frames, Renderer, RenderSettings

IMAGE_FORMAT = 1  # increase it when what is stored, or what an image looks like, changes
FRAMES_PER_CHUNK = 5  # reading a single frame decompresses five
FRAME = "experiment, sequence (0: AB, 1: CD), frame"
AXES = f"{FRAME}, row, column"
DESCRIPTIONS = {  # axes, meaning and unit, as files store them
    "rgb": (f"{AXES}, red green blue", "colours", ""),
    "depth": (AXES, "distance along the camera's axis; 0 where there is nothing", "mm"),
    "segmentation": (AXES, f"slot of the object that is seen; {NO_OBJECT} where there is none", ""),
    "boxes": (
        f"{FRAME}, slot, x1 y1 x2 y2",
        "first and last column and row of what is seen of the object; -1 where it is not seen",
        "px",
    ),
    "drawn": (FRAME, "1 where there is a picture; all else of a frame without one is zero, its boxes -1", ""),
}

# frames per second on one core, by resolution; MB of an experiment at 448 × 448 with all modalities
RENDERING = {
    "blocktower": ({112: 110, 224: 41, 448: 11}, 0.5),
    "balls": ({112: 65, 224: 27, 448: 8}, 1.6),
    "collision": ({112: 80, 224: 37, 448: 11}, 1.0),
}


class Images(ShardSet):
    """Images of frames of AB (sequence 0) and CD (1), in a directory below that of the states.

    rgb: (experiment, 2, T, R, R, 3) uint8. depth: (experiment, 2, T, R, R) uint16. segmentation: the same shape, uint8.
    boxes: (experiment, 2, T, slot, 4) int16. `DESCRIPTIONS` has their units and meanings. If only some frames are needed, the
    arrays have the same shapes; `drawn` (experiment, 2, T) marks the frames that exist, the others take no space.
    """

    def __init__(self, states: ExperimentSet, render: RenderSettings, needed: NeededFrames = ALL_FRAMES) -> None:
        self.states, self.render, self.needed = states, render, needed
        content = json.dumps([IMAGE_FORMAT, sorted(render.modalities), render.resolution, render.backend.value])
        is_rgb = render.modalities == ["rgb"]
        name = (
            f"{'rgb' if is_rgb else 'images'}-{render.resolution}-{render.backend.value}-"
            f"{hashlib.sha256(content.encode()).hexdigest()[:6]}{'' if needed == ALL_FRAMES else f'-{needed.name}'}"
        )
        choice = "render=rgb" if is_rgb else f"render=all 'render.modalities=[{','.join(render.modalities)}]'"
        command = (
            f"{states.command_for(needed.script)} {choice} render.resolution={render.resolution} "
            f"render.backend={render.backend.value} {needed.keys}"
        ).rstrip()
        super().__init__(states.spec, states.directory / name, title=f"images of {states.title}", command=command)
        self.place = None if states.place is None else states.place / name

    @property
    def name(self) -> str:
        """Return the name of its directory: modalities, resolution and renderer."""
        return self.directory.name

    def ensure(self, *, workers: int) -> None:
        """Generate and render what is missing; nothing if a superset is finished."""
        generation.ensure(self.states, workers=workers)
        generation.ensure(self.best_available(), workers=workers)

    def best_available(self, files: Files | None = None) -> "Images":
        """Return this set if it is finished or can be copied, otherwise such a superset, otherwise this set.

        An image is the same in all sets of one resolution and backend, so it is not rendered twice. More modalities are
        preferred to more frames.
        """
        if is_available(self, files):
            return self
        others = [name for name in MODALITIES if name not in self.render.modalities]
        added = [names for count in range(len(others) + 1) for names in itertools.combinations(others, count)]
        for needed, names in itertools.product((self.needed, *self.needed.supersets), added):
            modalities = [name for name in MODALITIES if name in (*self.render.modalities, *names)]
            images = Images(self.states, replace(self.render, modalities=modalities), needed)
            if is_available(images, files):
                return images
        return self

    def reader(self, arrays: Arrays) -> FrameReader:
        """Return a function that reads a frame; shards stay open."""
        opened = self.best_available()._opener()

        def read(row: int, sequence: int, time: int) -> np.ndarray:
            with opened(row) as (stored, place):
                if "drawn" in stored and not stored["drawn"][place, sequence, time]:
                    raise ValueError(f"frame {time} of sequence {sequence} was not requested, so it was not rendered")
                return np.asarray(stored["rgb"][place, sequence, time])

        return read

    def pictures(self, arrays: Arrays, modalities: Sequence[str]) -> ReadImages:
        """Return a function that reads all images of an experiment; shards stay open."""
        opened = self.best_available()._opener()

        def read(row: int) -> Arrays:
            with opened(row) as (stored, place):
                return {name: stored[name][place] for name in modalities}

        return read

    def _opener(self) -> Callable[[int], AbstractContextManager[tuple[h5py.File, int]]]:
        """Return a function that opens the shard of an experiment, each once, and yields it with the place of the experiment."""
        self.finished_checksums()
        files: dict[int, h5py.File] = {}
        per_shard = len(self.spec.experiments_of_shard(0))

        @contextmanager
        def opened(row: int) -> Iterator[tuple[h5py.File, int]]:
            shard, place = divmod(row, per_shard)
            with self.report_damage(shard):
                if shard not in files:
                    self.check(shard)
                    files[shard] = open_for_reading(self.path(shard))
                yield files[shard], place

        return opened

    def sequences(self, shard: int) -> Iterator[SequenceFrames]:
        source = self.best_available()
        needed = self._mask(shard, self.states.read(shard))
        with source.report_damage(shard), source.open(shard) as stored:
            for row, sequence in np.argwhere(needed.any(axis=2)).tolist():
                times = np.flatnonzero(needed[row, sequence])
                yield row, sequence, times, stored["rgb"][row, sequence, times]

    def cost(self, experiments: int) -> tuple[float, float]:
        scenario, pixels = self.spec.scenario, self.render.resolution**2
        if scenario.name not in RENDERING:
            return 0.0, 0.0
        rates, megabytes = RENDERING[scenario.name]
        seconds = np.interp(pixels, [edge**2 for edge in rates], [1 / rate for rate in rates.values()])
        frames = experiments * self.needed.frames_per_experiment(self.spec.num_experiments, scenario.clock.num_frames)
        share = frames / (2 * scenario.clock.num_frames) * pixels / 448**2
        return frames * float(seconds), share * megabytes

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Render the frames of a shard's experiments, a sequence at a time."""
        arrays, scenario = self.states.read(shard), self.spec.scenario
        needed = self._mask(shard, arrays)
        with (
            Renderer(scenario, self.render.resolution, self.render.backend) as renderer,
            create_file(path, self.fields(shard), self.attributes(shard)) as stored,
        ):
            stored["boxes"][...] = -1
            if "drawn" in stored:
                stored["drawn"][...] = needed
            for row in range(len(needed)):
                for sequence in np.flatnonzero(needed[row].any(axis=1)).tolist():
                    times = np.flatnonzero(needed[row, sequence])
                    frames = render_sequence(renderer, arrays, row, sequence, times)
                    for name in self.render.modalities:
                        stored[name][row, sequence, times] = getattr(frames, name)
                    stored["boxes"][row, sequence, times] = bounding_boxes(frames, scenario.num_slots)
                advance(1)
            return {"CPU-s inside PyBullet's camera": renderer.camera_seconds}

    def write_manifest(self, versions: Mapping[str, str] | None = None) -> None:
        super().write_manifest(versions)
        write_image_card(self.directory, self.title, self.command, self.fields(0))

    def check(self, shard: int) -> None:
        """Open the file and check its structure and states; pixels have checksums of their own."""
        with self.open(shard):
            pass

    def input_checksums(self, shard: int) -> dict[str, str]:
        return {"states_sha256": self.states.checksum(shard)}

    def fields(self, shard: int) -> Fields:
        size, scenario = self.render.resolution, self.spec.scenario
        frames = (len(self.spec.experiments_of_shard(shard)), 2, scenario.clock.num_frames)
        shapes = {
            "rgb": ((*frames, size, size, 3), "|u1"),
            "depth": ((*frames, size, size), "<u2"),
            "segmentation": ((*frames, size, size), "|u1"),
            "boxes": ((*frames, scenario.num_slots, 4), "<i2"),
        }
        fields = {}
        for name, (shape, dtype) in shapes.items():
            if name not in (*self.render.modalities, "boxes"):
                continue
            chunks = (1, 1, FRAMES_PER_CHUNK, *shape[3:])
            storage = {"chunks": chunks, "fletcher32": True, **hdf5plugin.Zstd(clevel=3)}
            axes, meaning, unit = DESCRIPTIONS[name]
            fields[name] = Field(shape, dtype, axes, meaning, unit, storage)
        if self.needed != ALL_FRAMES:
            fields["drawn"] = Field(frames, "|u1", *DESCRIPTIONS["drawn"])
        return fields

    def description(self) -> dict[str, Any]:
        """Return what was rendered, from which dataset, and how."""
        description = {
            "format": IMAGE_FORMAT,
            "dataset": self.states.id,
            "render": asdict(self.render) | {"backend": self.render.backend.value},
            "no_object": NO_OBJECT,
        }
        return description if self.needed == ALL_FRAMES else {**description, "frames": self.needed.name}

    def _mask(self, shard: int, states: Arrays) -> np.ndarray:
        first = self.spec.experiments_of_shard(shard)[0]
        return self.needed.mask(states["split"], first, self.spec.scenario.clock.num_frames)


def render_sequence(
    renderer: Renderer, arrays: Arrays, experiment: int, sequence: int, times: slice | Sequence[int] | np.ndarray
) -> Frames:
    """Render frames of one sequence (0: AB, 1: CD) of a loaded dataset, at some of the frame times."""
    states = arrays["states"][experiment, sequence, :: renderer.scenario.clock.states_per_frame][times]
    return renderer.render(
        states[..., :3],
        states[..., 3:7],
        presence=arrays["presence"][experiment, sequence],
        shapes=arrays["shape"][experiment].tolist(),
        background_seed=int(arrays["background_seed"][experiment]),
    )


def bounding_boxes(frames: Frames, num_slots: int) -> np.ndarray:
    """Return x1, y1, x2, y2 of the visible pixels of each slot's object, inclusive; -1 if none: (T, slot, 4) int16."""
    from scipy.ndimage import find_objects  # here: a third of a second that every command would spend at its start

    boxes = np.full((len(frames.segmentation), num_slots, 4), -1, dtype=np.int16)
    labels = frames.segmentation + np.uint8(1)  # 0 is background: NO_OBJECT, the largest uint8, wraps around to it
    for time, frame in enumerate(labels):
        for slot, place in enumerate(find_objects(frame, max_label=num_slots)):
            if place is not None:
                rows, columns = place
                boxes[time, slot] = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
    return boxes
