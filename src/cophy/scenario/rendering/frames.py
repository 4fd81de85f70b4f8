"""What is rendered: the pictures of a sequence, and the settings that ask for them."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

NO_OBJECT = 255  # in segmentations


class Backend(Enum):
    """tiny: PyBullet's CPU renderer. egl: its OpenGL plugin, on a GPU or on Mesa in software."""

    tiny = "tiny"
    egl = "egl"


@dataclass
class RenderSettings:
    """What to render (files in conf/render). modalities: rgb, depth, segmentation, or none of them."""

    modalities: list[str]
    resolution: int
    backend: Backend

    def __post_init__(self) -> None:
        unknown = set(self.modalities) - set(MODALITIES)
        if unknown:
            raise ValueError(f"render.modalities: {sorted(unknown)} not among {list(MODALITIES)}")
        if len(set(self.modalities)) < len(self.modalities):
            raise ValueError(f"render.modalities: {self.modalities} names one twice")
        if not 16 <= self.resolution <= 4096:
            raise ValueError(f"render.resolution={self.resolution} must be between 16 and 4096 pixels")


class Frames(NamedTuple):
    """Pictures of one sequence, R × R pixels.

    rgb: (T, R, R, 3) uint8. depth: (T, R, R) uint16, millimetres along the camera's axis, 0 where there is nothing.
    segmentation: (T, R, R) uint8, the slot whose object is seen, or NO_OBJECT.
    """

    rgb: np.ndarray
    depth: np.ndarray
    segmentation: np.ndarray


MODALITIES = Frames._fields
