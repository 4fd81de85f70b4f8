"""BlocktowerCF (paper Sec. 3): stacked cubes that stand or fall.

Analytical statics shows in microseconds which geometries are worth a simulation of their four sequences. Friction matters
only for how a tower falls; masses and gravity decide whether A and C stand. The search looks for geometries that stand under
some combinations of masses and gravity and fall under others, for which the two assigned configurations fall into the
assigned cells, and for which AB determines whether C stands.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import PairAssignment, select_seen
from cophy.scenario.confounders import Confounders
from cophy.scenario.experiment import Displace, DoOperation, Remove, TwinPair
from cophy.scenario.physics import Scene, Shape, Trajectory, trajectory_distance
from cophy.scenario.scenario import Scenario, disc_symmetries, square_symmetries
from cophy.scenario.simulator import Simulator
from cophy.scenario.statics import Combinations, TowerStatics
from cophy.scenario.towers import TOWER_BLOCKS, TOWER_CELLS, TowerCell, Towers, is_identifiable

NUM_ROTATIONS = 64  # ours: in steps of 5.6°; a multiple of 4, so that the symmetries of a square are included

# Effort of the search. Other values give other experiments, so increase `Scenario.search_version` with them.
NUM_TOWERS_PER_BATCH = 1024
NUM_VARIANTS_PER_TOWER = 48
MAX_BATCHES_PER_CONFIGURATION = 40

OBSERVED, COUNTERFACTUAL = 0, 1  # index of a sequence
Condition = Callable[[Towers, int], np.ndarray]  # (towers, index of their sequence) -> (tower,) bool


class Proposals(NamedTuple):
    """Candidate towers.

    Attributes:
        towers: A and C.
        falls_from: (proposal, combination) `TowerStatics.falls_from` of A, for every combination of masses and gravity.
        stands: (proposal, combination) bool, whether C stands.
        level: (proposal,) level of the block that is displaced or removed.
        offset: (proposal, 2) its displacement, or of the top block that is removed, its offset from the one below; metres.
    """

    towers: tuple[Towers, Towers]
    falls_from: np.ndarray
    stands: np.ndarray
    level: np.ndarray
    offset: np.ndarray


DISPLACEMENT_AXES = {"displace_x": (1.0, 0.0), "displace_y": (0.0, 1.0)}  # kind of do-operation -> direction


@dataclass
class Blocktower(Scenario):
    """Towers of blocks, with the fields of conf/scenario/blocktower.yaml beyond those of every scenario."""

    block_size: float
    max_level_offset: float  # of a block's centre from the one below, along each axis
    displacement: list[float]  # smallest and largest
    min_margin: float  # smallest distance of both twins' towers from toppling, or from standing
    stable_fraction: list[float]  # share of all configurations under which A, and C, stand: smallest and largest
    fallen_distance: float  # a tower has fallen once a block is this far from its start

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.num_objects) < 2 or ("remove_top" in self.do_operations and min(self.num_objects) < 3):
            raise ValueError(
                f"scenario.num_objects={list(self.num_objects)}: one block is no tower, and remove_top in scenario.do_operations leaves no tower of two "
                "blocks standing or falling; take it out, or have at least 3 objects"
            )

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

    def seen_configurations(self, num_objects: int, data_seed: int) -> np.ndarray:
        return select_seen(self.confounders, num_objects, self.symmetries(), data_seed)

    def search(
        self, assignment: PairAssignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind, cell = self.do_operations[assignment.do_operation], TOWER_CELLS[assignment.cell]
        first = self.confounders.decode(assignment.first, len(slots))
        for second in assignment.seconds:
            twins = (first, self.confounders.decode(second, len(slots)))
            for scene, do_operation in self.candidates(twins, cell, kind, slots, rng):
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

    def candidates(
        self,
        twins: tuple[Confounders, Confounders],
        cell: TowerCell,
        kind: str,
        slots: tuple[int, ...],
        rng: np.random.Generator,
    ) -> Iterator[tuple[Scene, DoOperation]]:
        """Yield scenes and do-operations for which, by statics, both twins fall into their cells.

        Args:
            twins: Confounders of the first and of the second twin.
            cell: Cell of the first twin.
            slots: Slots of the blocks of A, from the ground up.
        """
        if not _are_separable(*twins, num_levels=len(slots) - (kind == "remove_top")):
            return
        gravity_xy = np.array([confounders.gravity_xy for confounders in twins])
        twin_combinations = Combinations(np.array([c.mass for c in twins]), gravity_xy / -self.gravity_z)

        def fits_cells(towers: Towers, sequence: int) -> np.ndarray:
            signs = np.where([cell[sequence], cell.twin[sequence]], 1.0, -1.0)
            return np.asarray((self.statics.margins(*towers, twin_combinations) * signs >= self.min_margin).all(axis=1))

        combinations = self.statics.combinations(len(slots))
        twin_indices = combinations.nearest(twin_combinations)
        for _ in range(MAX_BATCHES_PER_CONFIGURATION):
            batch = self.propose(kind, len(slots), rng, fits_cells)
            identifiable = is_identifiable(batch.falls_from, batch.stands, combinations)[:, twin_indices].all(axis=1)
            for index in np.flatnonzero(identifiable).tolist():
                towers = batch.towers[OBSERVED]
                scene = towers.scene(index, slots, block_size=self.block_size, gravity_z=self.gravity_z)
                x, y = batch.offset[index].tolist()
                slot = slots[batch.level[index]]
                yield scene, Remove(kind, slot) if kind == "remove_top" else Displace(kind, slot, (x, y, 0.0))

    def propose(
        self, kind: str, num_levels: int, rng: np.random.Generator, condition: Condition | None = None
    ) -> Proposals:
        """Sample a batch of towers A and do-operations whose outcomes depend on the combination.

        One of A and C is sampled first, with many variants of each as the other one. If the top is removed, C is first
        and a block on top of it makes A. Otherwise A is first, and C has one of its blocks displaced.

        Args:
            num_levels: Number of blocks of A.
            condition: Filter of the towers; None accepts all.
        """
        order = (COUNTERFACTUAL, OBSERVED) if kind == "remove_top" else (OBSERVED, COUNTERFACTUAL)
        bases = self.sample_towers(num_levels - (kind == "remove_top"), rng)
        indices, base_falls = self._select_open(bases, num_levels, condition, order[0])
        bases = bases.select(indices)
        source = np.repeat(np.arange(len(indices)), NUM_VARIANTS_PER_TOWER)
        variants, level, offset = self._sample_variants(bases.select(source), kind, rng)
        indices, variant_falls = self._select_open(variants, num_levels, condition, order[1])
        towers = bases.select(source[indices]), variants.select(indices)
        falls_from = base_falls[source[indices]], variant_falls
        a, c = order.index(OBSERVED), order.index(COUNTERFACTUAL)
        stands = falls_from[c] == towers[c].xy.shape[1]
        return Proposals((towers[a], towers[c]), falls_from[a], stands, level[indices], offset[indices])

    def sample_towers(self, num_levels: int, rng: np.random.Generator) -> Towers:
        """Sample a batch of towers, which may stand or fall."""
        offset = self._level_offsets((NUM_TOWERS_PER_BATCH, num_levels), rng)
        offset[:, 0] = 0.0
        return Towers(np.cumsum(offset, axis=1), rng.uniform(0.0, np.pi / 2, (NUM_TOWERS_PER_BATCH, num_levels)))

    def _sample_variants(
        self, towers: Towers, kind: str, rng: np.random.Generator
    ) -> tuple[Towers, np.ndarray, np.ndarray]:
        """Displace a block of each tower (in place), or add one on top.

        Returns:
            The towers, the (tower,) level of the block and its (tower, 2) offset, metres.
        """
        count, num_levels = len(towers.xy), towers.xy.shape[1]
        if kind == "remove_top":
            offset = self._level_offsets((count,), rng)
            yaw = rng.uniform(0.0, np.pi / 2, count)
            return towers.with_top(towers.xy[:, -1] + offset, yaw), np.full(count, num_levels), offset
        distance = rng.uniform(self.displacement[0], self.displacement[1], count) * rng.choice([-1.0, 1.0], count)
        offset = distance[:, None] * np.array(DISPLACEMENT_AXES[kind])
        level = rng.integers(num_levels, size=count)
        towers.xy[np.arange(count), level] += offset
        return towers, level, offset

    def _level_offsets(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(-self.max_level_offset, self.max_level_offset, (*shape, 2))

    def _select_open(
        self, towers: Towers, num_levels: int, condition: Condition | None, sequence: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return indices and `falls_from` of towers that fulfil the condition and stand under some combinations only."""
        indices = np.arange(len(towers.xy)) if condition is None else np.flatnonzero(condition(towers, sequence))
        falls_from = self.statics.falls_from(*towers.select(indices), self.statics.combinations(num_levels))
        smallest, largest = self.stable_fraction
        share = (falls_from == towers.xy.shape[1]).mean(axis=1)
        is_open = (share >= smallest) & (share <= largest)
        return indices[is_open], falls_from[is_open]

    def _simulate_twins(
        self, scenes: list[Scene], stand: tuple[bool, bool], simulator: Simulator
    ) -> tuple[Trajectory, Trajectory] | None:
        """Simulate both twins, and return their trajectories if they stand or fall as required and differ, else None."""
        first, second = (self.simulate(simulator, scene) for scene in scenes)
        outcomes = (self.statics.stands(first), self.statics.stands(second))
        is_valid = outcomes == stand and trajectory_distance(first, second) >= self.min_difference
        return (first, second) if is_valid else None


def _are_separable(first: Confounders, second: Confounders, *, num_levels: int) -> bool:
    """Return whether gravity or the mass ratios of the upper blocks differ; otherwise the search is skipped.

    If only the mass of the lowest block differs, few towers stand for one twin and fall for the other, because the ground bears
    that mass as well.
    """
    upper = [np.array(confounders.mass[1:num_levels]) for confounders in (first, second)]
    ratios = [mass / mass[0] for mass in upper]
    return first.gravity_xy != second.gravity_xy or not np.allclose(*ratios)
