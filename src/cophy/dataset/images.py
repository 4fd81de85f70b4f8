"""The pictures of a dataset: RGB, depth and segmentation of its states, in shards beside them; all lossless."""

import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import h5py
import hdf5plugin
import numpy as np

from cophy.dataset import generation
from cophy.dataset.cards import write_picture_card
from cophy.dataset.experiment_set import ALL, Clip, ExperimentSet, NeededFrames, Pictures, Reader
from cophy.dataset.shards import Field, Fields, ShardSet, creating, open_for_reading
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Frames, Renderer, RenderSettings

Read = TypeVar("Read")
FORMAT_VERSION = 1  # raise it when what is stored, or what a picture looks like, changes
FRAMES_PER_CHUNK = 5  # a random frame costs the decompression of five
CHANNELS = {"rgb": ((3,), "|u1"), "depth": ((), "<u2"), "segmentation": ((), "|u1")}
AXES = "experiment, sequence (0: AB, 1: CD), frame, row, column"
SAID = {
    "rgb": {"axes": f"{AXES}, red green blue", "meaning": "colours"},
    "depth": {"axes": AXES, "unit": "mm", "meaning": "distance along the camera's axis; 0 where there is nothing"},
    "segmentation": {"axes": AXES, "meaning": f"slot of the object that is seen; {NO_OBJECT} where there is none"},
    "boxes": {
        "axes": "experiment, sequence (0: AB, 1: CD), frame, slot, x1 y1 x2 y2",
        "unit": "px",
        "meaning": "first and last column and row of what is seen of the object; -1 where it is not seen",
    },
    "drawn": {
        "axes": "experiment, sequence (0: AB, 1: CD), frame",
        "meaning": "1 where there is a picture; all else of a frame without one is zero, its boxes -1",
    },
}


class Images(ShardSet):
    """Pictures of frames of AB (sequence 0) and CD (1), in a directory below that of the states.

    rgb: (experiment, 2, T, R, R, 3) uint8. depth: (experiment, 2, T, R, R) uint16. segmentation: the same shape, uint8.
    boxes: (experiment, 2, T, slot, 4) int16. `SAID` has their units and meanings. Where only some frames are needed, all
    arrays are as large; `drawn` (experiment, 2, T) says which there are, and the others take no room.
    """

    def __init__(self, states: ExperimentSet, render: RenderSettings, needed: NeededFrames = ALL) -> None:
        self.states, self.render, self.needed = states, render, needed
        content = json.dumps([FORMAT_VERSION, sorted(render.modalities), render.resolution, render.backend.value])
        kind = "rgb" if render.modalities == ["rgb"] else "images"
        name = f"{kind}-{render.resolution}-{render.backend.value}-{hashlib.sha256(content.encode()).hexdigest()[:6]}"
        if needed != ALL:
            name = f"{name}-{needed.name}"
        choice = "render=rgb" if kind == "rgb" else f"render=all 'render.modalities=[{','.join(render.modalities)}]'"
        script, keys = needed.drawn_by
        command = (
            f"{states.command_for(script)} {choice} render.resolution={render.resolution} "
            f"render.backend={render.backend.value}{keys}"
        )
        super().__init__(states.spec, states.directory / name, title=f"pictures of {states.title}", command=command)

    @property
    def name(self) -> str:
        """Return the name of its directory: modalities, resolution and renderer."""
        return self.directory.name

    def ensure(self, *, workers: int) -> None:
        """Generate and render what is missing; nothing where another set holds the same pictures."""
        generation.ensure(self.states, workers=workers)
        generation.ensure(self.or_more(), workers=workers)

    def or_more(self) -> "Images":
        """The set that pictures are read from: itself, or where it is not there, a finished one with more.

        A picture is the same in all sets of one resolution and backend, so it is not rendered twice. More modalities are
        preferred to more frames.
        """
        if self.is_finished():
            return self
        others = [name for name in MODALITIES if name not in self.render.modalities]
        added = [more for count in range(len(others) + 1) for more in itertools.combinations(others, count)]
        for needed, more in itertools.product((self.needed, *self.needed.wider), added):
            wanted = [name for name in MODALITIES if name in (*self.render.modalities, *more)]
            found = Images(self.states, replace(self.render, modalities=wanted), needed)
            if found.is_finished():
                return found
        return self

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads frames; keeps the shards open that it has read from."""
        opened = self.or_more()._opening()
        return lambda row, sequence, time: opened(row, partial(_frame, sequence=sequence, time=time))

    def pictures(self, arrays: dict[str, np.ndarray], modalities: Sequence[str]) -> Pictures:
        """Reads experiments; keeps the shards open that it has read from."""
        opened = self.or_more()._opening()

        def read(row: int) -> dict[str, np.ndarray]:
            return opened(row, lambda stored, place: {name: stored[name][place] for name in modalities})

        return read

    def _opening(self) -> Callable[[int, Callable[[h5py.File, int], Read]], Read]:
        """Opens the shard of an experiment once, and reads from it."""
        self.finished_checksums()
        opened: dict[int, h5py.File] = {}
        per_shard = len(self.spec.experiments_of_shard(0))

        def read(row: int, part: Callable[[h5py.File, int], Read]) -> Read:
            shard, place = divmod(row, per_shard)
            with self.explained(shard):
                if shard not in opened:
                    self.check(self.path(shard), shard)
                    opened[shard] = open_for_reading(self.path(shard))
                return part(opened[shard], place)

        return read

    def sequences(self, shard: int) -> Iterator[Clip]:
        source = self.or_more()
        needed = self._needed(shard, self.states.read(shard))
        with source.explained(shard), source.opened(source.path(shard), shard) as stored:
            for row, sequence in np.argwhere(needed.any(axis=2)).tolist():
                times = np.flatnonzero(needed[row, sequence])
                yield row, sequence, times, stored["rgb"][row, sequence, times]

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Draw the frames of a shard's experiments, a sequence at a time."""
        arrays, scenario = self.states.read(shard), self.spec.scenario
        stride, needed = scenario.clock.states_per_frame, self._needed(shard, arrays)
        with (
            Renderer(scenario, self.render.resolution, self.render.backend) as renderer,
            creating(path, self.fields(shard), self.attributes(shard)) as stored,
        ):
            stored["boxes"][...] = -1
            if "drawn" in stored:
                stored["drawn"][...] = needed
            for row, states in enumerate(arrays["states"]):
                for sequence in np.flatnonzero(needed[row].any(axis=1)).tolist():
                    times = np.flatnonzero(needed[row, sequence])
                    seen = states[sequence, ::stride][times]
                    frames = renderer.render(
                        seen[..., :3],
                        seen[..., 3:7],
                        presence=arrays["presence"][row, sequence],
                        shapes=arrays["shape"][row].tolist(),
                        background_seed=int(arrays["background_seed"][row]),
                    )
                    for name in self.render.modalities:
                        stored[name][row, sequence, times] = getattr(frames, name)
                    stored["boxes"][row, sequence, times] = bounding_boxes(frames, scenario.num_slots)
                advance(1)
            return {"CPU-s inside PyBullet's camera": renderer.camera_seconds}

    def write_manifest(self) -> None:
        """Vouch for finished pictures, and say what they are."""
        super().write_manifest()
        write_picture_card(self.directory, self.title, self.command, self.fields(0))

    def check(self, path: Path, shard: int) -> None:
        """The right arrays, and of the states that lie beside them; pixels have checksums of their own."""
        with self.opened(path, shard):
            pass

    def sources(self, shard: int) -> dict[str, str]:
        """The states that are shown."""
        return {"states_sha256": self.states.checksum(shard)}

    def fields(self, shard: int) -> Fields:
        size, scenario = self.render.resolution, self.spec.scenario
        sequences = (len(self.spec.experiments_of_shard(shard)), 2, scenario.clock.num_frames)
        fields = {
            name: _field(name, (*sequences, size, size, *channels), dtype)
            for name, (channels, dtype) in CHANNELS.items()
            if name in self.render.modalities
        }
        fields["boxes"] = _field("boxes", (*sequences, scenario.num_slots, 4), "<i2")
        return (
            fields
            if self.needed == ALL
            else {
                **fields,
                "drawn": Field(sequences, "|u1", axes=SAID["drawn"]["axes"], meaning=SAID["drawn"]["meaning"]),
            }
        )

    def description(self) -> dict[str, Any]:
        """What was rendered, of which dataset, and with what."""
        settings = asdict(self.render) | {"backend": self.render.backend.value}
        of_some = {} if self.needed == ALL else {"frames": self.needed.name}
        return {
            "format": FORMAT_VERSION,
            "dataset": self.states.id,
            "render": settings,
            "no_object": NO_OBJECT,
            **of_some,
        }

    def _needed(self, shard: int, states: dict[str, np.ndarray]) -> np.ndarray:
        first = self.spec.experiments_of_shard(shard)[0]
        return self.needed.of(states["split"], first, self.spec.scenario.clock.num_frames)


def _frame(stored: h5py.File, place: int, *, sequence: int, time: int) -> np.ndarray:
    if "drawn" in stored and not stored["drawn"][place, sequence, time]:
        raise ValueError(f"frame {time} of sequence {sequence} was not asked for, so it was not drawn")
    return np.asarray(stored["rgb"][place, sequence, time])


def _field(name: str, shape: tuple[int, ...], dtype: str) -> Field:
    chunks = (1, 1, FRAMES_PER_CHUNK, *shape[3:])
    return Field(
        shape, dtype, storage={"chunks": chunks, "fletcher32": True, **hdf5plugin.Zstd(clevel=3)}, **SAID[name]
    )


def bounding_boxes(frames: Frames, num_slots: int) -> np.ndarray:
    """(T, slot, 4) int16: x1, y1, x2, y2 of the pixels of each slot's object, inclusive; -1 where it is not seen."""
    from scipy.ndimage import find_objects  # here: a third of a second that every command would spend at its start

    boxes = np.full((len(frames.segmentation), num_slots, 4), -1, dtype=np.int16)
    labels = frames.segmentation + np.uint8(1)  # 0 is background: NO_OBJECT, the largest uint8, wraps around to it
    for time, frame in enumerate(labels):
        for slot, found in enumerate(find_objects(frame, max_label=num_slots)):
            if found is not None:
                rows, columns = found
                boxes[time, slot] = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
    return boxes
