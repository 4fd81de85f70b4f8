"""The fixed camera of a scenario, and where in its picture a point appears."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

NEAR_PLANE_M = 0.1  # a point nearer than this, or behind the camera, is projected as if it lay on it


class Window(NamedTuple):
    """A square part of a square picture: its left and top end and its edge, as shares of the picture's edge."""

    left: float
    top: float
    edge: float

    def cut(self, pictures: np.ndarray) -> np.ndarray:
        """This part of pictures (T, R, R, ...), of pixels that lie in it only by a part too."""
        size = pictures.shape[1]
        width = min(size, int(np.ceil(self.edge * size)) + 1)
        left, top = (min(int(start * size), size - width) for start in (self.left, self.top))
        return pictures[:, top : top + width, left : left + width]


@dataclass
class Camera:
    """Looks from `eye` to `target`, metres, z up; vertical field of view in degrees."""

    eye: list[float]
    target: list[float]
    field_of_view_deg: float

    def __post_init__(self) -> None:
        if len(self.eye) != 3 or len(self.target) != 3 or list(self.eye) == list(self.target):
            raise ValueError("camera: eye and target are two points, x, y and z each")
        if not 0 < self.field_of_view_deg < 180:
            raise ValueError(f"camera.field_of_view_deg={self.field_of_view_deg} must be between 0 and 180")

    def project(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """(..., 3) metres -> (..., 2) pixels in a square picture: x to the right, y down, from its upper left corner."""
        forward = _unit(np.subtract(self.target, self.eye))
        right = _unit(np.cross(forward, (0.0, 0.0, 1.0)))
        axes = np.stack([right, np.cross(right, forward), forward])
        x, y, depth = np.moveaxis((np.asarray(points, dtype=np.float64) - self.eye) @ axes.T, -1, 0)
        scale = 1 / (np.tan(np.radians(self.field_of_view_deg) / 2) * np.maximum(depth, NEAR_PLANE_M))
        return np.stack([1 + x * scale, 1 - y * scale], axis=-1) * (resolution / 2)

    def window_around(self, points: np.ndarray, radius_m: float) -> Window:
        """The smallest part of the picture in which balls of this radius around the points, (N, 3) metres, are in sight.

        What lies outside the picture stays outside.
        """
        corners = radius_m * np.array(list(np.ndindex(2, 2, 2))) * 2 - radius_m
        seen = np.clip(self.project(np.asarray(points)[:, None] + corners, 1), 0, 1).reshape(-1, 2)
        low, high = seen.min(axis=0), seen.max(axis=0)
        edge = float((high - low).max())
        left, top = np.clip((low + high - edge) / 2, 0, 1 - edge).tolist()
        return Window(left, top, edge)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))
