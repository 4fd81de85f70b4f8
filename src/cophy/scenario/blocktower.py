"""BlocktowerCF (paper Sec. 3): stacked cubes that stand or fall.

`TowerSearch` proposes towers by analytical statics; only the four sequences of promising proposals are simulated.
"""

from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import PairAssignment, select_seen
from cophy.scenario.experiment import TwinPair
from cophy.scenario.physics import Scene, Shape, Trajectory, trajectory_distance
from cophy.scenario.scenario import Scenario, disc_symmetries, square_symmetries
from cophy.scenario.simulator import Simulator
from cophy.scenario.statics import TowerStatics
from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS, TowerSearch

NUM_ROTATIONS = 64  # ours: in steps of 5.6°; a multiple of 4, so that the symmetries of a square are included


@dataclass
class Blocktower(Scenario):
    """Towers of blocks, with the fields of conf/scenario/blocktower.yaml beyond those of every scenario."""

    block_size: float
    max_level_offset: float  # of a block's centre from the one below, along each axis
    displacement: list[float]  # smallest and largest
    min_margin: float  # smallest distance of both twins' towers from toppling, or from standing
    stable_fraction: list[float]  # share of all configurations under which A, and C, stand: smallest and largest
    fallen_distance: float  # a tower has fallen once a block is this far from its start

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
        return square_symmetries()

    @classmethod
    def augmentations(cls) -> np.ndarray:
        return disc_symmetries(NUM_ROTATIONS)

    @property
    def farthest_m(self) -> float:
        # a fallen block hardly comes to rest farther away than the height of the tower
        return 2 * max(self.num_objects) * self.block_size

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
        """Search for towers by analytical statics."""
        return TowerSearch(
            statics=self.statics,
            max_level_offset=self.max_level_offset,
            displacement=self.displacement,
            min_margin=self.min_margin,
            stable_fraction=self.stable_fraction,
        )

    def seen_configurations(self, num_objects: int, data_seed: int) -> np.ndarray:
        return select_seen(self.confounders, num_objects, self.symmetries(), data_seed)

    def search(
        self, assignment: PairAssignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind, cell = self.do_operations[assignment.do_operation], TOWER_CELLS[assignment.cell]
        first = self.confounders.decode(assignment.first, len(slots))
        for second in assignment.seconds:
            twins = (first, self.confounders.decode(second, len(slots)))
            for scene, do_operation in self.tower_search.candidates(twins, cell, kind, slots, rng):
                scenes = [self.with_configuration(c, scene) for c in (assignment.first, second)]
                ab = self._simulate_twins(scenes, (cell.observed, cell.twin.observed), simulator)
                if ab is None:
                    continue
                starts = [do_operation.apply(a) for a in scenes]
                cd = self._simulate_twins(starts, (cell.counterfactual, cell.twin.counterfactual), simulator)
                if cd is not None:
                    cells = (TOWER_CELLS.index(cell), TOWER_CELLS.index(cell.twin))
                    return TwinPair(scene, do_operation, second, ab, cd, cells)
        raise CophyError("no tower fits: widen scenario.max_level_offset or scenario.stable_fraction")

    def _simulate_twins(
        self, scenes: list[Scene], stand: tuple[bool, bool], simulator: Simulator
    ) -> tuple[Trajectory, Trajectory] | None:
        """Simulate both twins, and return their trajectories if they stand or fall as required and differ, else None."""
        first, second = (self.simulate(simulator, scene) for scene in scenes)
        outcomes = (self.statics.stands(first), self.statics.stands(second))
        is_valid = outcomes == stand and trajectory_distance(first, second) >= self.min_difference
        return (first, second) if is_valid else None
