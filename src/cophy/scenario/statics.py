"""Analytical statics: whether a tower of blocks stands, for thousands of towers and confounders at once.

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
    """Combinations of masses and gravity. Whether a tower stands does not depend on friction.

    Attributes:
        mass: (combination, level), kg, from the ground up.
        tilt: (combination, 2), horizontal over vertical gravity.
    """

    mass: np.ndarray
    tilt: np.ndarray

    def nearest(self, queries: "Combinations") -> np.ndarray:
        """Return (query,) indices of the combinations that equal the queries, or are nearest to them."""
        rows, query_rows = (np.hstack([each.mass, each.tilt]) for each in (self, queries))
        return np.asarray(np.abs(query_rows[:, None] - rows).sum(axis=-1).argmin(axis=1))


@dataclass(frozen=True)
class TowerStatics:
    """Statics of a scenario's towers.

    Attributes:
        block_size: Edge of a block, metres.
        gravity_z: m/s², negative.
        grid: Values of the confounders.
        fallen_distance: A tower has fallen once a block is this far from its start, metres.
    """

    block_size: float
    gravity_z: float
    grid: ConfounderGrid
    fallen_distance: float

    def combinations(self, num_levels: int) -> Combinations:
        """Return every combination of masses and gravity for this number of blocks, in the order of the grid."""
        mass, gravity_xy = self.grid.masses_and_gravities(num_levels)
        return Combinations(mass, gravity_xy / -self.gravity_z)

    def margins(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        """Return the distance of each tower to toppling under each combination; it stands where this is positive.

        Args:
            xy: (tower, level, 2) block centres, metres.
            yaw: (tower, level) rad.
            combinations: May have more levels than the towers; the masses of the lowest ones are used.

        Returns:
            (tower, combination) metres, the smallest of `joint_margins`.
        """
        return np.asarray(self._joint_margins(xy, yaw, combinations).min(axis=-1))

    def falls_from(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        """Return the lowest block that certainly falls, with all blocks above it, under each combination.

        It rests on the highest joint that fails. If lower joints fail too, the blocks between may stay, because their
        load is gone once those above have fallen. Arguments are those of `margins`.

        Returns:
            (tower, combination) level of the block from the ground up; the number of levels if the tower stands.
        """
        num_levels = xy.shape[1]
        fails = self._joint_margins(xy, yaw, combinations) <= 0
        highest = num_levels - 1 - fails[..., ::-1].argmax(axis=-1)
        return np.asarray(np.where(fails.any(axis=-1), highest, num_levels))

    def _joint_margins(self, xy: np.ndarray, yaw: np.ndarray, combinations: Combinations) -> np.ndarray:
        mass = combinations.mass[:, : xy.shape[1]]
        return joint_margins(xy, yaw, mass, combinations.tilt, size_m=self.block_size)

    def stands(self, trajectory: Trajectory) -> bool:
        """Return whether no block of a simulated tower ever moves by `fallen_distance` or more."""
        distance = np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=-1)
        return bool(distance.max() < self.fallen_distance)


def joint_margins(
    xy: np.ndarray, yaw: np.ndarray, mass: np.ndarray, tilt: np.ndarray, *, size_m: float = 1.0
) -> np.ndarray:
    """Return the distance of each tower to toppling over each of its joints, under each combination.

    Args:
        xy: (tower, level, 2) block centres, metres; levels from the ground up.
        yaw: (tower, level) rad.
        mass: (combination, level) kg.
        tilt: (combination, 2) horizontal over vertical gravity.
        size_m: Edge of a block, metres.

    Returns:
        (tower, combination, level) metres: the distance from the projected centre of mass of a block and all above it to the
        edge of the contact polygon below the block. A tower stands if all are positive; a negative value bounds the distance.
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
