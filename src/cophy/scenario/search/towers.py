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
    """Whether the tower of AB stands, and that of CD."""

    observed: bool
    counterfactual: bool

    @property
    def opposite(self) -> "TowerCell":
        """The cell of the twin: it has the opposite outcome in both sequences."""
        return TowerCell(not self.observed, not self.counterfactual)

    @property
    def name(self) -> str:
        """For example stands_falls."""
        return "_".join("stands" if stands else "falls" for stands in self)


# of the first twin; the second has the opposite cell
TOWER_CELLS = (TowerCell(True, True), TowerCell(False, False), TowerCell(True, False), TowerCell(False, True))


def agreement(stands: np.ndarray, cell: TowerCell) -> np.ndarray:
    """How much a standing A tells about C.

    Args:
        stands: (geometry, 2, combination) bool, of A and of C.
        cell: of either twin.

    Returns:
        (geometry,) of the combinations under which A stands, the share under which C does as it does for the twin whose A stands.
    """
    observed, counterfactual = stands[:, 0], stands[:, 1]
    share = (observed & counterfactual).sum(axis=1) / observed.sum(axis=1)
    return np.asarray(share if cell.observed == cell.counterfactual else 1 - share)
