"""When a tower of blocks stands: statics on paper, for thousands of towers and confounders at once.

A stack of rigid blocks stands exactly when, at every level, the combined centre of mass of everything above
projects, along the tilted gravity, inside the contact polygon: the intersection of the two rotated faces. A point
lies inside an intersection when it lies inside both squares, so no polygon is ever clipped.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.physics.scene import Trajectory


class Combinations(NamedTuple):
    """Combinations of masses and gravity. Friction has no part in whether a tower stands.

    mass: (combination, level), kg, from the ground up. tilt: (combination, 2), horizontal over vertical gravity.
    """

    mass: np.ndarray
    tilt: np.ndarray


@dataclass(frozen=True)
class TowerStatics:
    """What decides whether a scenario's towers stand.

    block_size: edge of a block, metres. gravity_z: m/s², negative. grid: the values of the confounders.
    fallen_distance: a tower has fallen once a block is this far from where it started, metres.
    min_agreement: least share of the combinations under which A stands that must agree on whether C stands.
    """

    block_size: float
    gravity_z: float
    grid: ConfounderGrid
    fallen_distance: float
    min_agreement: float

    def combinations(self, num_levels: int) -> Combinations:
        """Every combination of masses and gravity for so many blocks, in the order of the grid."""
        mass, gravity_xy = self.grid.masses_and_gravities(num_levels)
        return Combinations(mass, gravity_xy / -self.gravity_z)

    def margins(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        """How far from toppling towers are under each combination: they stand where this is positive.

        Args:
            xy: (tower, level, 2) block centres, metres.
            yaw: (tower, level) rad.
            combinations: may have more levels; of a tower that lost its top, the masses of what is left count.

        Returns:
            (tower, combination) metres, see `tower_margins`.
        """
        mass = combinations.mass[:, : xy.shape[1]]
        return tower_margins(xy, yaw, mass, combinations.tilt, size_m=self.block_size)

    def stands(self, trajectory: Trajectory) -> bool:
        """Whether in a simulation no block ever left its place by more than `fallen_distance`."""
        moved = np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=-1)
        return bool(moved.max() < self.fallen_distance)


def tower_margins(
    xy: np.ndarray, yaw: np.ndarray, mass: np.ndarray, tilt: np.ndarray, *, size_m: float = 1.0
) -> np.ndarray:
    """How far from toppling each tower is under each combination of masses and gravity.

    Args:
        xy: (tower, level, 2) block centres, metres; levels from the ground up.
        yaw: (tower, level) rad.
        mass: (combination, level) kg.
        tilt: (combination, 2) horizontal over vertical gravity.
        size_m: edge of a block, metres.

    Returns:
        (tower, combination) metres: the smallest distance, over levels, of the projected centre of mass to the edge of the
        contact polygon. Positive where the tower stands; negative where it falls (there a bound on the distance).
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
