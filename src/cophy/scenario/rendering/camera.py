"""The fixed camera of a scenario, and where in its picture a point appears."""

from dataclasses import dataclass

import numpy as np

NEAR_PLANE_M = 0.1  # a point nearer than this, or behind the camera, is projected as if it lay on it


@dataclass
class Camera:
    """Looks from `eye` to `target`, metres, z up; vertical field of view in degrees."""

    eye: list[float]
    target: list[float]
    field_of_view_deg: float

    def project(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """(..., 3) metres -> (..., 2) pixels in a square picture: x to the right, y down, from its upper left corner."""
        forward = _unit(np.subtract(self.target, self.eye))
        right = _unit(np.cross(forward, (0.0, 0.0, 1.0)))
        axes = np.stack([right, np.cross(right, forward), forward])
        x, y, depth = np.moveaxis((np.asarray(points, dtype=np.float64) - self.eye) @ axes.T, -1, 0)
        scale = 1 / (np.tan(np.radians(self.field_of_view_deg) / 2) * np.maximum(depth, NEAR_PLANE_M))
        return np.stack([1 + x * scale, 1 - y * scale], axis=-1) * (resolution / 2)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))
