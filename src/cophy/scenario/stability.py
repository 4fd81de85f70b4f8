"""When a tower of blocks stands: statics on paper, for thousands of towers and confounders at once.

A stack of rigid blocks stands exactly when, at every level, the combined centre of mass of everything above
projects, along the tilted gravity, inside the contact polygon: the intersection of the two rotated faces. A point
lies inside an intersection when it lies inside both squares, so no polygon is ever clipped.
"""

import numpy as np


def tower_margins(
    xy: np.ndarray, yaw: np.ndarray, mass: np.ndarray, tilt: np.ndarray, *, size_m: float = 1.0
) -> np.ndarray:
    """How far from toppling each tower is under each configuration, in metres: it stands where this is positive.

    xy: (tower, level, 2) block centres, m; yaw: (tower, level), rad; levels from the ground up.
    mass: (configuration, level), kg; tilt: (configuration, 2), horizontal over vertical gravity.
    Returns (tower, configuration): the smallest distance, over levels, of the projected centre of mass to the edge
    of the contact polygon; negative outside (there a bound on the distance).
    """
    num_levels = xy.shape[1]
    height = (np.arange(num_levels) + 0.5) * size_m
    cos, sin = np.cos(yaw), np.sin(yaw)
    margins = np.full((len(xy), len(mass)), np.inf)
    for level in range(num_levels):
        weight = mass[:, level:] / mass[:, level:].sum(axis=1, keepdims=True)
        centre = np.einsum("ck,nkd->ncd", weight, xy[:, level:])
        point = centre + tilt * (weight @ height[level:] - level * size_m)[:, None]
        for face in (level - 1, level) if level else (level,):
            x, y = np.moveaxis(point - xy[:, face, None], -1, 0)
            along = np.abs(cos[:, face, None] * x + sin[:, face, None] * y)
            across = np.abs(cos[:, face, None] * y - sin[:, face, None] * x)
            margins = np.minimum(margins, size_m / 2 - np.maximum(along, across))
    return margins
