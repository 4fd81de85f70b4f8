"""When a tower of blocks stands: statics on paper, for thousands of towers and confounders at once.

A stack of rigid blocks stands exactly when, at every level, the combined centre of mass of everything above
projects, along the tilted gravity, inside the contact polygon: the intersection of the two rotated faces. A point
lies inside an intersection when it lies inside both squares, so no polygon is ever clipped.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.physics import Trajectory


class Combinations(NamedTuple):
    """Combinations of masses and gravity. Friction has no part in whether a tower stands.

    mass: (combination, level), kg, from the ground up. tilt: (combination, 2), horizontal over vertical gravity.
    """

    mass: np.ndarray
    tilt: np.ndarray

    def find(self, wanted: "Combinations") -> np.ndarray:
        """(wanted,) the index of each, or of the nearest."""
        here, there = (np.hstack([each.mass, each.tilt]) for each in (self, wanted))
        return np.asarray(np.abs(there[:, None] - here).sum(axis=-1).argmin(axis=1))


@dataclass(frozen=True)
class TowerStatics:
    """What decides whether a scenario's towers stand.

    block_size: edge of a block, metres. gravity_z: m/s², negative. grid: the values of the confounders.
    fallen_distance: a tower has fallen once a block is this far from where it started, metres.
    """

    block_size: float
    gravity_z: float
    grid: ConfounderGrid
    fallen_distance: float

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
            (tower, combination) metres, the smallest of `joint_margins`.
        """
        return np.asarray(self._joint_margins(xy, yaw, combinations).min(axis=-1))

    def falls_from(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        """The lowest block that is sure to fall, with all above it, under each combination.

        It lies on the highest joint that fails. Where lower joints fail too, the blocks between may stay: they are
        relieved once those above have gone.

        Args:
            xy: (tower, level, 2) block centres, metres.
            yaw: (tower, level) rad.
            combinations: as of `margins`.

        Returns:
            (tower, combination) its level from the ground up; the number of levels where the tower stands.
        """
        num_levels = xy.shape[1]
        fails = self._joint_margins(xy, yaw, combinations) <= 0
        highest = num_levels - 1 - fails[..., ::-1].argmax(axis=-1)
        return np.asarray(np.where(fails.any(axis=-1), highest, num_levels))

    def _joint_margins(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        mass = combinations.mass[:, : xy.shape[1]]
        return joint_margins(xy, yaw, mass, combinations.tilt, size_m=self.block_size)

    def stands(self, trajectory: Trajectory) -> bool:
        """Whether in a simulation no block ever left its place by more than `fallen_distance`."""
        moved = np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=-1)
        return bool(moved.max() < self.fallen_distance)


def joint_margins(
    xy: np.ndarray, yaw: np.ndarray, mass: np.ndarray, tilt: np.ndarray, *, size_m: float = 1.0
) -> np.ndarray:
    """How far each tower is from toppling over each of its joints, under each combination of masses and gravity.

    Args:
        xy: (tower, level, 2) block centres, metres; levels from the ground up.
        yaw: (tower, level) rad.
        mass: (combination, level) kg.
        tilt: (combination, 2) horizontal over vertical gravity.
        size_m: edge of a block, metres.

    Returns:
        (tower, combination, level) metres: the distance of the projected centre of mass, of a block and all above it, to the
        edge of the contact polygon below it. A tower stands where all are positive; negative ones are a bound on the distance.
    """
    num_levels = xy.shape[1]
    height = (np.arange(num_levels) + 0.5) * size_m
    cos, sin = np.cos(yaw), np.sin(yaw)
    margins = np.full((len(xy), len(mass), num_levels), np.inf)
    for level in range(num_levels):
        weight = mass[:, level:] / mass[:, level:].sum(axis=1, keepdims=True)
        centre = np.einsum("ck,nkd->ncd", weight, xy[:, level:])
        point = centre + tilt * (weight @ height[level:] - level * size_m)[:, None]
        for face in (level - 1, level) if level else (level,):
            x, y = np.moveaxis(point - xy[:, face, None], -1, 0)
            along = np.abs(cos[:, face, None] * x + sin[:, face, None] * y)
            across = np.abs(cos[:, face, None] * y - sin[:, face, None] * x)
            margins[..., level] = np.minimum(margins[..., level], size_m / 2 - np.maximum(along, across))
    return margins
