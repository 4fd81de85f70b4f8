"""RGB frames of released experiments, decoded from their clips when they are asked for.

Which experiments of a folder are meant, and as what they are read.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cophy.dataset import generation
from cophy.dataset.experiment_set import ALL, Clip, ExperimentSet, Pictures, Reader
from cophy.errors import CophyError
from cophy.released.formats import SEQUENCES
from cophy.released.protocol import ID, ReleasedFormat
from cophy.scenario import Scenario
from cophy.untrusted_files import BrokenFileError, open_clip

FORMAT_VERSION = 1  # raise it when the arrays of an index, or what is read into them, change
EXPERIMENTS_PER_SHARD = 500  # ours: a few MiB of states


@dataclass(frozen=True)
class ReleasedSpec:
    """Which experiments are meant: a folder's, read as a scenario with its grid and clock. ids: its subfolders."""

    scenario: Scenario
    num_objects: int
    released_format: ReleasedFormat
    directory: Path
    ids: tuple[str, ...]

    @property
    def num_experiments(self) -> int:
        """Subfolders, broken and empty ones included."""
        return len(self.ids)

    @property
    def num_shards(self) -> int:
        """Files of the index."""
        return -(-len(self.ids) // EXPERIMENTS_PER_SHARD)

    def experiments_of_shard(self, shard: int) -> range:
        """Indices of the experiments in a shard."""
        first = shard * EXPERIMENTS_PER_SHARD
        return range(first, min(first + EXPERIMENTS_PER_SHARD, len(self.ids)))

    def reading(self) -> dict[str, Any]:
        """All that the index depends on besides what is in the files."""
        scenario = asdict(self.scenario)
        read_as = {key: scenario[key] for key in ("name", "colors", "confounders", "gravity_z", "clock")}
        return {
            "format": FORMAT_VERSION,
            # the released format; the key stays "layout" because the names of indices on disk are hashes of this
            "layout": self.released_format.name,
            "directory": str(self.directory.resolve()),
            "num_objects": self.num_objects,
            "scenario": read_as,
            "ids": hashlib.sha256(" ".join(self.ids).encode()).hexdigest(),
        }

    @cached_property
    def id(self) -> str:
        """Name of the index: objects, format and a hash of what is read, and how."""
        text = json.dumps(self.reading(), sort_keys=True)
        return f"{self.num_objects}-{self.released_format.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def listing(directory: Path) -> tuple[str, ...]:
    """The experiments of a folder: its subfolders with the name of an id, numbers in their order. Links are none."""
    try:
        with os.scandir(directory) as entries:
            names = [e.name for e in entries if e.is_dir(follow_symlinks=False) and ID.fullmatch(e.name)]
    except OSError as error:
        raise CophyError(
            f"{directory} cannot be listed ({error.strerror}): source.root= is the folder that holds ballsCF, blocktowerCF, …"
        ) from error
    if not names:
        raise CophyError(f"{directory} holds no experiments")
    return tuple(sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name)))


class Clips:
    """The pictures of released experiments, where they have some: always all, for which are tested on depends on the lists."""

    name = "rgb.mp4"
    needed = ALL

    def __init__(self, states: ExperimentSet, spec: ReleasedSpec) -> None:
        self.states, self.spec = states, spec

    def ensure(self, *, workers: int) -> None:
        """Index the experiments; their clips cannot be made."""
        generation.ensure(self.states, workers=workers)

    def checksums(self) -> None:
        """Clips lie where they were released, and are not vouched for."""

    def sequences(self, shard: int) -> Iterator[Clip]:
        """Every frame of what has a clip."""
        experiments, times = self.spec.experiments_of_shard(shard), range(self.spec.scenario.clock.num_frames)
        for row, sequence in np.argwhere(self.states.read(shard)["clip"]).tolist():
            yield row, sequence, np.array(times), np.stack(list(self._decoded(experiments[row], sequence, times)))

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads (row of the arrays, sequence, time)."""
        return partial(self._rgb, arrays["experiment"])

    def pictures(self, arrays: dict[str, np.ndarray], modalities: Sequence[str]) -> Pictures:
        """Decodes both clips of an experiment; there is RGB alone."""
        if unknown := set(modalities) - {"rgb"}:
            raise CophyError(f"released data have no {', '.join(sorted(unknown))}, of pictures only rgb")
        times = range(self.spec.scenario.clock.num_frames)

        def read(row: int) -> dict[str, np.ndarray]:
            experiment = int(arrays["experiment"][row])
            directory = self.spec.directory / self.spec.ids[experiment]
            if not arrays["clip"][row].all():
                raise CophyError(f"{directory} lacks a clip")
            ab, cd = (np.stack(list(self._decoded(experiment, sequence, times))) for sequence in (0, 1))
            if ab.shape != cd.shape:
                raise CophyError(f"{directory}: the clips of ab and cd differ in size: download it again")
            return {"rgb": np.stack([ab, cd])}

        return read

    def _rgb(self, experiment: np.ndarray, row: int, sequence: int, time: int) -> np.ndarray:
        (frame,) = self._decoded(int(experiment[row]), sequence, range(time, time + 1))
        return frame

    def _decoded(self, experiment: int, sequence: int, times: range) -> Iterator[np.ndarray]:
        """(R, R, 3) uint8 each. Frames before the first are passed over one by one: a seek is not exact in every MP4."""
        path = self.spec.directory / self.spec.ids[experiment] / SEQUENCES[sequence] / self.name
        step, position = self.spec.released_format.frame_step, 0
        try:
            capture = open_clip(path)
        except BrokenFileError as error:
            raise CophyError(str(error)) from error
        try:
            for wanted in (time * step for time in times):
                for _ in range(wanted - position):
                    capture.grab()
                found, frame = capture.read()
                position = wanted + 1
                if not found or frame.shape[0] != frame.shape[1]:
                    raise CophyError(f"{path} has no square frame {wanted}: download it again")
                yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        finally:
            capture.release()
