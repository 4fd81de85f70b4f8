"""RGB frames of released experiments, decoded from their clips when they are asked for."""

from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np

from cophy.dataset.external.files import BrokenFileError, open_clip
from cophy.dataset.external.index import ExternalStates
from cophy.dataset.external.spec import ExternalSpec
from cophy.dataset.pictures import Clip, Reader
from cophy.errors import CophyError

SEQUENCES = ("ab", "cd")


class Clips:
    """What `dataset.images.Images` is for generated data."""

    name = "rgb.mp4"

    def __init__(self, states: ExternalStates) -> None:
        self.states = states
        self.spec: ExternalSpec = states.spec

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads (row of the arrays, sequence, time)."""
        return partial(self._rgb, arrays["experiment"])

    @property
    def command_for_estimates(self) -> str:
        """The command that de-renders these clips; it lacks the de-renderer."""
        return self.states.command.replace("src/audit.py", "src/derender.py")

    def checksums(self) -> None:
        """Clips lie where they were released, and are not vouched for."""

    def checksum_of_states(self, shard: int) -> str:
        """SHA-256 of the index of the experiments that the clips of a shard show."""
        return self.states.finished_checksums()[self.states.path(shard).name]

    def sequences(self, shard: int) -> Iterator[Clip]:
        """(experiment of the shard, sequence, RGB (T, R, R, 3)) of those that have a clip."""
        experiments = self.spec.experiments_of_shard(shard)
        for row, sequence in np.argwhere(self.states.with_clip(shard)).tolist():
            times = range(self.spec.scenario.clock.num_frames)
            yield row, sequence, np.stack(list(self._decoded(experiments[row], sequence, times)))

    def _rgb(self, experiment: np.ndarray, row: int, sequence: int, time: int) -> np.ndarray:
        (frame,) = self._decoded(int(experiment[row]), sequence, range(time, time + 1))
        return frame

    def _decoded(self, experiment: int, sequence: int, times: range) -> Iterator[np.ndarray]:
        """(R, R, 3) uint8 each. Frames before the first are passed over one by one: a seek is not exact in every MP4."""
        path = self.spec.directory / self.spec.ids[experiment] / SEQUENCES[sequence] / self.name
        step, position = self.spec.layout.frame_step, 0
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
