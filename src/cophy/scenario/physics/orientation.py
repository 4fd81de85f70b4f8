"""Where a body's own axes point.

Written out, because `scipy.spatial.transform.Rotation` raises for quaternions that are zero or NaN. Empty slots have
such, and so has damaged data, which an audit has to look at.
"""

import numpy as np


def x_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """(..., 4) quaternions -> (..., 3) unit vectors along the bodies' own x axes."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=-1)


def z_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """(..., 4) quaternions -> (..., 3) unit vectors along the bodies' own z axes."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
