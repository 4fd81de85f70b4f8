"""The pictures of a dataset: RGB, depth and segmentation of its states, in shards beside them; all lossless."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np

from cophy.dataset.pictures import Clip, Reader
from cophy.dataset.shardset import DamagedShardError, ShardSet, dataset_in
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.scenario.rendering import NO_OBJECT, Frames, Renderer, RenderSettings

FORMAT_VERSION = 1  # raise it when what is stored, or what a picture looks like, changes
FRAMES_PER_CHUNK = 5  # a random frame costs the decompression of five
CHANNELS = {"rgb": ((3,), "|u1"), "depth": ((), "<u2"), "segmentation": ((), "|u1")}
SOURCE = "states_sha256"  # attribute of a shard: the states it shows


class Images(ShardSet):
    """Pictures of every frame of AB (sequence 0) and CD (1), in a directory below that of the states.

    rgb: (experiment, 2, T, R, R, 3) uint8. depth: (experiment, 2, T, R, R) uint16, millimetres along the camera's axis,
    0 where there is nothing. segmentation: the same shape, uint8, slot or 255. boxes: (experiment, 2, T, slot, 4) int16,
    first and last column and row (x1, y1, x2, y2) of what is seen of the object, -1 where nothing is.
    """

    spec: DatasetSpec

    def __init__(self, states: States, render: RenderSettings) -> None:
        self.states, self.render = states, render
        content = json.dumps([FORMAT_VERSION, sorted(render.modalities), render.resolution, render.backend.value])
        kind = "rgb" if render.modalities == ["rgb"] else "images"
        name = f"{kind}-{render.resolution}-{render.backend.value}-{hashlib.sha256(content.encode()).hexdigest()[:6]}"
        choice = "render=rgb" if kind == "rgb" else f"render=all 'render.modalities=[{','.join(render.modalities)}]'"
        command = (
            f"{states.command} {choice} render.resolution={render.resolution} render.backend={render.backend.value}"
        )
        super().__init__(states.spec, states.directory / name, title=f"pictures of {states.title}", command=command)

    @property
    def name(self) -> str:
        """Of its directory: modalities, resolution and renderer."""
        return self.directory.name

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads frames; keeps the shards open that it has read from."""
        self.finished_checksums()
        opened: dict[int, h5py.Dataset] = {}

        def read(row: int, sequence: int, time: int) -> np.ndarray:
            shard, place = divmod(row, self.spec.size.experiments_per_shard)
            with self.explained(shard):
                if shard not in opened:
                    self.check(self.path(shard), shard)
                    opened[shard] = h5py.File(self.path(shard), "r")["rgb"]
                return np.asarray(opened[shard][place, sequence, time])

        return read

    @property
    def command_for_estimates(self) -> str:
        """The command that de-renders these pictures; it lacks the de-renderer."""
        return self.states.command.replace("src/generate.py", "src/derender.py")

    def sequences(self, shard: int) -> Iterator[Clip]:
        """(experiment of the shard, sequence, RGB (T, R, R, 3)), in their order."""
        with self.explained(shard):
            self.check(self.path(shard), shard)
        with h5py.File(self.path(shard), "r") as file:
            for row in range(len(self.spec.experiments_of_shard(shard))):
                for sequence in (0, 1):
                    with self.explained(shard):
                        rgb = file["rgb"][row, sequence]
                    yield row, sequence, rgb

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Draw all frames of a shard's experiments, a sequence at a time."""
        checksum = self.checksum_of_states(shard)
        arrays, scenario = self.states.read(shard, checksum), self.spec.scenario
        stride = scenario.clock.states_per_frame
        with (
            Renderer(scenario, self.render.resolution, self.render.backend) as renderer,
            h5py.File(path, "w", libver=("v110", "v110")) as file,
        ):
            file.attrs[SOURCE] = checksum
            stored = {
                name: file.create_dataset(
                    name,
                    shape,
                    dtype,
                    chunks=(1, 1, FRAMES_PER_CHUNK, *shape[3:]),
                    fletcher32=True,
                    track_times=False,
                    **hdf5plugin.Zstd(clevel=3),
                )
                for name, (shape, dtype) in self._layout(shard).items()
            }
            for row, states in enumerate(arrays["states"]):
                for sequence in (0, 1):
                    seen = states[sequence, ::stride]
                    frames = renderer.render(
                        seen[..., :3],
                        seen[..., 3:7],
                        presence=arrays["presence"][row, sequence],
                        shapes=arrays["shape"][row].tolist(),
                        background_seed=int(arrays["background_seed"][row]),
                    )
                    for name in self.render.modalities:
                        stored[name][row, sequence] = getattr(frames, name)
                    stored["boxes"][row, sequence] = bounding_boxes(frames, scenario.num_slots)
                advance(1)
            return {"CPU-s inside PyBullet's camera": renderer.camera_seconds}

    def check(self, path: Path, shard: int) -> None:
        """The right arrays, and of the states that lie beside them."""
        try:
            with h5py.File(path, "r") as file:
                for name, (shape, dtype) in self._layout(shard).items():
                    dataset_in(file, name, shape, dtype)
                source = file.attrs[SOURCE]
        except (OSError, KeyError, RuntimeError) as error:
            raise DamagedShardError(" ".join(str(error).split())) from error
        if source != self.checksum_of_states(shard):
            raise DamagedShardError("it shows other states than those beside it")

    def description(self) -> dict[str, Any]:
        """What was rendered, of which dataset, and with what."""
        settings = asdict(self.render) | {"backend": self.render.backend.value}
        return {"format": FORMAT_VERSION, "dataset": self.spec.id, "render": settings, "no_object": NO_OBJECT}

    def checksum_of_states(self, shard: int) -> str:
        """SHA-256 of the states that a shard shows."""
        return self.states.finished_checksums()[self.states.path(shard).name]

    def _layout(self, shard: int) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and dtype of every array in a shard."""
        size, clock = self.render.resolution, self.spec.scenario.clock
        sequences = (len(self.spec.experiments_of_shard(shard)), 2, clock.num_frames)
        layout = {
            name: ((*sequences, size, size, *channels), dtype)
            for name, (channels, dtype) in CHANNELS.items()
            if name in self.render.modalities
        }
        return layout | {"boxes": ((*sequences, self.spec.scenario.num_slots, 4), "<i2")}


def bounding_boxes(frames: Frames, num_slots: int) -> np.ndarray:
    """(T, slot, 4) int16: x1, y1, x2, y2 of the pixels of each slot's object, inclusive; -1 where it is not seen."""
    boxes = np.full((len(frames.segmentation), num_slots, 4), -1, dtype=np.int16)
    for slot in np.unique(frames.segmentation).tolist():
        if slot == NO_OBJECT:
            continue
        mask = frames.segmentation == slot
        columns, rows = mask.any(axis=1), mask.any(axis=2)
        seen, last = columns.any(axis=1), frames.segmentation.shape[1] - 1
        corners = [columns.argmax(1), rows.argmax(1), last - columns[:, ::-1].argmax(1), last - rows[:, ::-1].argmax(1)]
        boxes[seen, slot] = np.stack(corners, axis=-1)[seen]
    return boxes
