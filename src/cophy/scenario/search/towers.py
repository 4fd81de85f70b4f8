"""Towers as the search handles them: geometries by the thousand, and the cells that they are to fill."""

from typing import NamedTuple

import numpy as np

from cophy.scenario.physics.scene import Body, Scene, Shape
from cophy.scenario.physics.surroundings import floor


class Towers(NamedTuple):
    """Geometries. xy: (tower, level, 2) block centres, metres. yaw: (tower, level), rad. Levels from the ground up."""

    xy: np.ndarray
    yaw: np.ndarray

    def take(self, index: np.ndarray) -> "Towers":
        """Some of them, by their indices or by a mask."""
        return Towers(self.xy[index], self.yaw[index])

    def with_top(self, xy: np.ndarray, yaw: np.ndarray) -> "Towers":
        """All of them with one more block on top, whose centre is at (tower, 2) and whose yaw is (tower,)."""
        return Towers(np.concatenate([self.xy, xy[:, None]], axis=1), np.concatenate([self.yaw, yaw[:, None]], axis=1))

    def scene(self, index: int, slots: tuple[int, ...], *, block_size: float, gravity_z: float) -> Scene:
        """One of them as a scene, confounders not set.

        Args:
            index: which one.
            slots: of its blocks, from the ground up.
            block_size: metres.
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
        return Scene((floor(), *blocks), gravity=(0.0, 0.0, gravity_z))


def tower_of(scene: Scene) -> Towers:
    """The one tower of a scene, which must be upright."""
    blocks = scene.objects
    yaw = [2 * np.arctan2(block.quaternion_xyzw[2], block.quaternion_xyzw[3]) for block in blocks]
    return Towers(np.array([[block.position[:2] for block in blocks]]), np.array([yaw]))


class TowerCell(NamedTuple):
    """Whether the tower of AB stands, that of CD, and that of the twin's AB. The twin's CD has the opposite outcome."""

    observed: bool
    counterfactual: bool
    twin_observed: bool

    @property
    def twin(self) -> "TowerCell":
        """The cell of the twin."""
        return TowerCell(self.twin_observed, not self.counterfactual, self.observed)

    @property
    def name(self) -> str:
        """For example stands_falls: A stands and C falls. Where A falls under the twin's confounders too, both_fall_falls."""
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

# Blocks of pairs (see `assign`), as indices into TOWER_CELLS of the first twins. In eight blocks of ten A falls under both
# twins, so that only how it falls tells the confounders. In each block both configurations meet both outcomes of C.
_SAME, _OPPOSITE, _BOTH_FALL = (0, 1), (2, 3), (4, 5)
TOWER_BLOCKS = (*[_BOTH_FALL] * 4, _SAME, *[_BOTH_FALL] * 4, _OPPOSITE)
