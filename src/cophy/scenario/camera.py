"""The fixed camera of a scenario, and projections into its image."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

MIN_DEPTH_M = 0.1  # points nearer than this, or behind the camera, are projected as if they were at this depth


class Window(NamedTuple):
    """A square part of a square image: left edge, top edge and size as shares of the size of the image."""

    left: float
    top: float
    edge: float

    def cut(self, images: np.ndarray) -> np.ndarray:
        """Crop images (T, R, R, ...); pixels that are partly inside are included."""
        size = images.shape[1]
        width = min(size, int(np.ceil(self.edge * size)) + 1)
        left, top = (min(int(start * size), size - width) for start in (self.left, self.top))
        return images[:, top : top + width, left : left + width]


@dataclass
class Camera:
    """Camera at `eye` that looks to `target`, metres, z up, with a vertical field of view in degrees."""

    eye: list[float]
    target: list[float]
    field_of_view_deg: float

    def __post_init__(self) -> None:
        if len(self.eye) != 3 or len(self.target) != 3 or list(self.eye[:2]) == list(self.target[:2]):
            raise ValueError("camera: eye and target must be two points, x, y and z each, and not one above the other")
        if not 0 < self.field_of_view_deg < 180:
            raise ValueError(f"camera.field_of_view_deg={self.field_of_view_deg} must be between 0 and 180")

    def project(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """Project (..., 3) metres to (..., 2) pixels of a square image: x to the right, y down, from the upper left corner."""
        x, y, depth = self._in_view(points)
        scale = 1 / (np.tan(np.radians(self.field_of_view_deg) / 2) * np.maximum(depth, MIN_DEPTH_M))
        return np.stack([1 + x * scale, 1 - y * scale], axis=-1) * (resolution / 2)

    def pixels_per_metre(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """Return (...) pixels that a metre across the line of sight has at (..., 3) points in metres."""
        depth = np.maximum(self._in_view(points)[2], MIN_DEPTH_M)
        return np.asarray(resolution / 2 / (np.tan(np.radians(self.field_of_view_deg) / 2) * depth))

    def window_around(self, points: np.ndarray, radius_m: float) -> Window:
        """Return the smallest window that contains balls of this radius around points, (N, 3) metres.

        Parts outside the image are ignored.
        """
        corners = radius_m * np.array(list(np.ndindex(2, 2, 2))) * 2 - radius_m
        projected = np.clip(self.project(np.asarray(points)[:, None] + corners, 1), 0, 1).reshape(-1, 2)
        low, high = projected.min(axis=0), projected.max(axis=0)
        edge = float((high - low).max())
        left, top = np.clip((low + high - edge) / 2, 0, 1 - edge).tolist()
        return Window(left, top, edge)

    def _in_view(self, points: np.ndarray) -> np.ndarray:
        """Return (3, ...) metres to the right, upwards and forwards from the camera."""
        forward = _unit(np.subtract(self.target, self.eye))
        right = _unit(np.cross(forward, (0.0, 0.0, 1.0)))
        axes = np.stack([right, np.cross(right, forward), forward])
        return np.moveaxis((np.asarray(points, dtype=np.float64) - self.eye) @ axes.T, -1, 0)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))
