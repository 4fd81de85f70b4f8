"""Search for towers: analytical statics shows in microseconds which geometries are worth a simulation.

Friction matters only for how a tower falls; masses and gravity decide whether A and C stand. The search looks for geometries
that stand under some combinations of masses and gravity and fall under others, for which the two assigned configurations
fall into the assigned cells, and for which AB determines whether C stands.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.scenario.confounders import Confounders
from cophy.scenario.experiment import Displace, DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Shape, make_floor
from cophy.scenario.statics import Combinations, TowerStatics


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
            index: Index of the tower.
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
        offset: (proposal, 2) its displacement, metres.
    """

    towers: tuple[Towers, Towers]
    falls_from: np.ndarray
    stands: np.ndarray
    level: np.ndarray
    offset: np.ndarray


DISPLACEMENT_AXES = {"displace_x": (1.0, 0.0), "displace_y": (0.0, 1.0)}  # kind of do-operation -> direction


@dataclass(frozen=True)
class TowerSearch:
    """Search for towers A and do-operations, with fields of `Blocktower`."""

    statics: TowerStatics
    max_level_offset: float
    displacement: list[float]
    min_margin: float
    stable_fraction: list[float]

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
            kind: Kind of do-operation.
            slots: Slots of the blocks of A, from the ground up.
            rng: The only source of randomness.
        """
        if not _are_separable(*twins, num_levels=len(slots) - (kind == "remove_top")):
            return
        gravity_xy = np.array([confounders.gravity_xy for confounders in twins])
        twin_combinations = Combinations(np.array([c.mass for c in twins]), gravity_xy / -self.statics.gravity_z)

        def fits_cells(towers: Towers, sequence: int) -> np.ndarray:
            signs = np.where([cell[sequence], cell.twin[sequence]], 1.0, -1.0)
            return np.asarray((self.statics.margins(*towers, twin_combinations) * signs >= self.min_margin).all(axis=1))

        combinations = self.statics.combinations(len(slots))
        twin_indices = combinations.nearest(twin_combinations)
        for _ in range(MAX_BATCHES_PER_CONFIGURATION):
            batch = self.propose(kind, len(slots), rng, fits_cells)
            identifiable = is_identifiable(batch.falls_from, batch.stands, combinations)[:, twin_indices].all(axis=1)
            for index in np.flatnonzero(identifiable).tolist():
                scene = self.scene(batch.towers[OBSERVED], index, slots)
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
            kind: Kind of do-operation.
            num_levels: Number of blocks of A.
            rng: The only source of randomness.
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

    def scene(self, towers: Towers, index: int, slots: tuple[int, ...]) -> Scene:
        """Return one of the towers as a scene without confounders, with the slots of its blocks from the ground up."""
        return towers.scene(index, slots, block_size=self.statics.block_size, gravity_z=self.statics.gravity_z)

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


def _are_separable(first: Confounders, second: Confounders, *, num_levels: int) -> bool:
    """Return whether gravity or the mass ratios of the upper blocks differ; otherwise the search is skipped.

    If only the mass of the lowest block differs, few towers stand for one twin and fall for the other, because the ground bears
    that mass as well.
    """
    upper = [np.array(confounders.mass[1:num_levels]) for confounders in (first, second)]
    ratios = [mass / mass[0] for mass in upper]
    return first.gravity_xy != second.gravity_xy or not np.allclose(*ratios)


def is_identifiable(falls_from: np.ndarray, stands: np.ndarray, combinations: Combinations) -> np.ndarray:
    """Return whether AB determines if C stands (paper Sec. 3: AB must show the confounders).

    It does if C has the same outcome under all combinations of masses and gravity that look the same in AB. A tower that
    stands shows only that it stands. A tower that falls shows gravity and the masses of the falling blocks up to a common
    factor. Nothing shows the masses of blocks that stay in place.

    Args:
        falls_from: (tower, combination) of A, see `TowerStatics.falls_from`.
        stands: (tower, combination) bool, of C.
        combinations: Combinations of masses and gravity.

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
