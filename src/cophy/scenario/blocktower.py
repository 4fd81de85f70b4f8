"""BlocktowerCF (paper Sec. 3): stacked cubes that stand or fall, found by statics on paper, then simulated.

`TowerSearch` proposes on paper; only the four sequences that are likely to be kept are simulated.
"""

from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import Assignment, half_of_problems
from cophy.scenario.experiment import TwinPair
from cophy.scenario.physics import Scene, Shape, Trajectory, trajectory_distance
from cophy.scenario.scenario import TURNS, Scenario, disc, square
from cophy.scenario.simulator import Simulator
from cophy.scenario.statics import TowerStatics
from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS, TowerSearch


@dataclass
class Blocktower(Scenario):
    """Fields of conf/scenario/blocktower.yaml beyond those of every scenario."""

    block_size: float
    max_level_offset: float  # of a block's centre from the one below, along each axis
    displacement: list[float]  # smallest and largest
    min_margin: float  # both twins' towers are this far from toppling, or from standing
    stable_fraction: list[float]  # share of all configurations under which A, and C, must stand: smallest, largest
    fallen_distance: float  # a tower has fallen once a block is this far from where it started

    @classmethod
    def search_version(cls) -> int:
        return 2

    @classmethod
    def ranges(cls) -> tuple[str, ...]:
        return ("displacement", "stable_fraction")

    @classmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        return ("displace_x", "displace_y", "remove_top")

    @classmethod
    def cells(cls) -> tuple[str, ...]:
        return tuple(cell.name for cell in TOWER_CELLS)

    @classmethod
    def blocks(cls) -> tuple[tuple[int, ...], ...]:
        return TOWER_BLOCKS

    @classmethod
    def cell_meaning(cls) -> str:
        return "outcome of AB, of CD"

    @classmethod
    def symmetries(cls) -> np.ndarray:
        return square()

    @classmethod
    def augmentations(cls) -> np.ndarray:
        return disc(TURNS)

    @property
    def farthest_m(self) -> float:
        return (
            2 * max(self.num_objects) * self.block_size
        )  # a fallen block lies not farther than a tower is high, or little

    @property
    def object_size_m(self) -> float:
        return self.block_size

    @property
    def shape_from_positions(self) -> Shape:
        return Shape.BOX

    @property
    def statics(self) -> TowerStatics:
        return TowerStatics(
            block_size=self.block_size,
            gravity_z=self.gravity_z,
            grid=self.confounders,
            fallen_distance=self.fallen_distance,
        )

    @property
    def tower_search(self) -> TowerSearch:
        """What proposes towers on paper."""
        return TowerSearch(
            statics=self.statics,
            max_level_offset=self.max_level_offset,
            displacement=self.displacement,
            min_margin=self.min_margin,
            stable_fraction=self.stable_fraction,
        )

    def seen_configurations(self, num_objects: int, data_seed: int) -> np.ndarray:
        return half_of_problems(self.confounders, num_objects, self.symmetries(), data_seed)

    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind, cell = self.do_operations[assignment.do_operation], TOWER_CELLS[assignment.cell]
        first = self.confounders.decode(assignment.first, len(slots))
        for second in assignment.seconds:
            twins = (first, self.confounders.decode(second, len(slots)))
            for scene, do_operation in self.tower_search.candidates(twins, cell, kind, slots, rng):
                scenes = [self.under(configuration, scene) for configuration in (assignment.first, second)]
                ab = self._simulated(scenes, (cell.observed, cell.twin.observed), simulator)
                if ab is None:
                    continue
                after = [do_operation.apply(a) for a in scenes]
                cd = self._simulated(after, (cell.counterfactual, cell.twin.counterfactual), simulator)
                if cd is not None:
                    cells = (TOWER_CELLS.index(cell), TOWER_CELLS.index(cell.twin))
                    return TwinPair(scene, do_operation, second, ab, cd, cells)
        raise CophyError("no tower fits: widen scenario.max_level_offset or scenario.stable_fraction")

    def _simulated(
        self, scenes: list[Scene], stand: tuple[bool, bool], simulator: Simulator
    ) -> tuple[Trajectory, Trajectory] | None:
        """Both twins' trajectories, if they stand or fall as they should and differ significantly."""
        first, second = (self.simulate(simulator, scene) for scene in scenes)
        outcomes = (self.statics.stands(first), self.statics.stands(second))
        as_they_should = outcomes == stand and trajectory_distance(first, second) >= self.min_difference
        return (first, second) if as_they_should else None
