"""Towers: their geometry, the cells of their outcomes, and whether AB determines those of CD."""

from typing import NamedTuple

import numpy as np

from cophy.scenario.physics import Body, Scene, Shape, make_floor
from cophy.scenario.statics import Combinations


class Towers(NamedTuple):
    """Geometries of towers.

    Attributes:
        xy: (tower, level, 2) block centres, metres, from the ground up.
        yaw: (tower, level), rad.
    """

    xy: np.ndarray
    yaw: np.ndarray

    def select(self, index: np.ndarray) -> "Towers":
        """Select towers by indices or by a mask."""
        return Towers(self.xy[index], self.yaw[index])

    def with_top(self, xy: np.ndarray, yaw: np.ndarray) -> "Towers":
        """Add a block with centre (tower, 2) and yaw (tower,) on top of every tower."""
        return Towers(np.concatenate([self.xy, xy[:, None]], axis=1), np.concatenate([self.yaw, yaw[:, None]], axis=1))

    def scene(self, index: int, slots: tuple[int, ...], *, block_size: float, gravity_z: float) -> Scene:
        """Return one of the towers as a scene without confounders.

        Args:
            slots: Slots of its blocks, from the ground up.
            block_size: Edge of a block, metres.
            gravity_z: m/s².
        """
        xy, yaw = self.xy[index], self.yaw[index]
        blocks = tuple(
            Body(
                Shape.BOX,
                (block_size, block_size, block_size),
                position=(float(xy[level, 0]), float(xy[level, 1]), (level + 0.5) * block_size),
                quaternion_xyzw=(0.0, 0.0, float(np.sin(yaw[level] / 2)), float(np.cos(yaw[level] / 2))),
                slot=slot,
                mass=1.0,
            )
            for level, slot in enumerate(slots)
        )
        return Scene((make_floor(), *blocks), gravity=(0.0, 0.0, gravity_z))


def read_tower(scene: Scene) -> Towers:
    """Return the geometry of a scene's one tower, which must be upright."""
    blocks = scene.objects
    yaw = [2 * np.arctan2(block.quaternion_xyzw[2], block.quaternion_xyzw[3]) for block in blocks]
    return Towers(np.array([[block.position[:2] for block in blocks]]), np.array([yaw]))


class TowerCell(NamedTuple):
    """Whether the towers of AB, of CD and of the twin's AB stand. The twin's CD has the opposite outcome of CD."""

    observed: bool
    counterfactual: bool
    twin_observed: bool

    @property
    def twin(self) -> "TowerCell":
        """The cell of the twin."""
        return TowerCell(self.twin_observed, not self.counterfactual, self.observed)

    @property
    def name(self) -> str:
        """Name such as stands_falls: A stands and C falls. If A also falls for the twin, it is both_fall_falls."""
        observed, counterfactual = ("stands" if stands else "falls" for stands in self[:2])
        both_fall = not (self.observed or self.twin_observed)
        return f"{'both_fall' if both_fall else observed}_{counterfactual}"


TOWER_CELLS = (
    TowerCell(True, True, twin_observed=False),
    TowerCell(False, False, twin_observed=True),
    TowerCell(True, False, twin_observed=False),
    TowerCell(False, True, twin_observed=True),
    TowerCell(False, True, twin_observed=False),
    TowerCell(False, False, twin_observed=False),
)

# Blocks of pairs (see `assign`), as indices into TOWER_CELLS of the first twins. In eight of ten blocks A falls for both
# twins, so that only the way in which it falls shows the confounders. In each block, both configurations have both outcomes of C.
_SAME, _OPPOSITE, _BOTH_FALL = (0, 1), (2, 3), (4, 5)
TOWER_BLOCKS = (*[_BOTH_FALL] * 4, _SAME, *[_BOTH_FALL] * 4, _OPPOSITE)


def is_identifiable(falls_from: np.ndarray, stands: np.ndarray, combinations: Combinations) -> np.ndarray:
    """Return whether AB determines if C stands (paper Sec. 3: AB must show the confounders).

    It does if C has the same outcome under all combinations of masses and gravity that look the same in AB. A tower that
    stands shows only that it stands. A tower that falls shows gravity and the masses of the falling blocks up to a common
    factor. Nothing shows the masses of blocks that stay in place.

    Args:
        falls_from: (tower, combination) of A, see `TowerStatics.falls_from`.
        stands: (tower, combination) bool, of C.

    Returns:
        (tower, combination) bool.
    """
    appearance = _index_appearances(combinations)
    group = appearance[falls_from, np.arange(falls_from.shape[1])]
    group = group + appearance.size * np.arange(len(falls_from))[:, None]
    size = np.bincount(group.ravel())
    standing = np.bincount(group.ravel(), weights=stands.ravel())
    return np.asarray(((standing == 0) | (standing == size))[group])


def _index_appearances(combinations: Combinations) -> np.ndarray:
    """Return (level + 1, combination) indices of what AB shows if the tower falls from a level; in the last row, if it stands."""
    count, num_levels = combinations.mass.shape
    appearance = np.zeros((num_levels + 1, count), dtype=np.int64)
    for level in range(num_levels):
        falling = combinations.mass[:, level:]
        visible = np.hstack([falling / falling.max(axis=1, keepdims=True), combinations.tilt])
        appearance[level] = 1 + level * count + np.unique(visible, axis=0, return_inverse=True)[1].reshape(-1)
    return appearance
