"""RGB frames of released experiments, decoded from their clips when they are asked for."""

from collections.abc import Iterator, Sequence
from functools import partial

import cv2
import numpy as np

from cophy.dataset import generation
from cophy.dataset.pictures.needed_frames import ALL
from cophy.dataset.released.formats.columns import SEQUENCES
from cophy.dataset.released.released_spec import ReleasedSpec
from cophy.dataset.released.untrusted_files import BrokenFileError, open_clip
from cophy.dataset.store.experiment_set import Clip, ExperimentSet, Pictures, Reader
from cophy.errors import CophyError


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
