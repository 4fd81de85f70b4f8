"""RGB frames of released experiments, decoded from their clips when they are asked for."""

from functools import partial

import cv2
import numpy as np

from cophy.dataset.external.files import BrokenFileError, open_clip
from cophy.dataset.external.index import ExternalStates
from cophy.dataset.external.spec import ExternalSpec
from cophy.dataset.pictures import Reader
from cophy.errors import CophyError

SEQUENCES = ("ab", "cd")


class Clips:
    """What `dataset.images.Images` is for generated data."""

    name = "rgb.mp4"

    def __init__(self, states: ExternalStates) -> None:
        self.spec: ExternalSpec = states.spec

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads (row of the arrays, sequence, time)."""
        return partial(self._rgb, arrays["experiment"])

    def _rgb(self, experiment: np.ndarray, row: int, sequence: int, time: int) -> np.ndarray:
        """(R, R, 3) uint8. Frames before it are decoded too: seeking by number is not exact in every MP4."""
        path = self.spec.directory / self.spec.ids[experiment[row]] / SEQUENCES[sequence] / self.name
        try:
            capture = open_clip(path)
        except BrokenFileError as error:
            raise CophyError(str(error)) from error
        try:
            for _ in range(time * self.spec.layout.frame_step):
                capture.grab()
            found, frame = capture.read()
        finally:
            capture.release()
        if not found or frame.shape[0] != frame.shape[1]:
            raise CophyError(f"{path} has no square frame {time * self.spec.layout.frame_step}: download it again")
        return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
