"""What AB shows of a tower, on paper, and whether that settles if C stands (paper Sec. 3: AB has to tell the confounders).

Towers as the search handles them: geometries by the thousand, and the cells that they are to fill.
The search for towers: statics on paper tells in microseconds which geometries are worth a simulation.

Friction only matters for how a tower falls, so masses and gravity decide whether A and C stand. The search looks for geometries
whose outcomes are open, and lets the two prescribed configurations fill their cells.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.scenario.confounders import Confounders
from cophy.scenario.experiment import Displace, DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Shape, floor
from cophy.scenario.statics import Combinations, TowerStatics


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


# how hard the search tries; other values find other experiments, so raise `Scenario.search_version` with them
NUM_TOWERS_PER_BATCH = 1024
NUM_VARIANTS_PER_TOWER = 48
MAX_BATCHES_PER_CONFIGURATION = 40

OBSERVED, COUNTERFACTUAL = 0, 1  # sequences
Wanted = Callable[[Towers, int], np.ndarray]  # (towers, the sequence they are for) -> (tower,) bool


class Proposals(NamedTuple):
    """Candidate towers.

    towers: A and C. falls_from: of A, stands: of C; (proposal, combination), under every combination of masses and gravity.
    level: (proposal,) of the block that the do-operation concerns. offset: (proposal, 2) by how much it is displaced, metres.
    """

    towers: tuple[Towers, Towers]
    falls_from: np.ndarray
    stands: np.ndarray
    level: np.ndarray
    offset: np.ndarray


DISPLACEMENT_AXES = {"displace_x": (1.0, 0.0), "displace_y": (0.0, 1.0)}  # kind of do-operation -> direction (x, y)


@dataclass(frozen=True)
class TowerSearch:
    """Finds towers A and do-operations; the fields are those of `Blocktower`."""

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
        """Scenes and do-operations that by statics fill the cell for the first twin and the twin's cell for the second.

        Args:
            twins: confounders of the first and of the second twin.
            cell: of the first twin.
            kind: of do-operation.
            slots: of the blocks of A, from the ground up.
            rng: what is drawn comes from it.
        """
        if not _separable(*twins, num_levels=len(slots) - (kind == "remove_top")):
            return
        gravity_xy = np.array([confounders.gravity_xy for confounders in twins])
        loads = Combinations(np.array([c.mass for c in twins]), gravity_xy / -self.statics.gravity_z)

        def fills_cells(towers: Towers, sequence: int) -> np.ndarray:
            signs = np.where([cell[sequence], cell.twin[sequence]], 1.0, -1.0)
            return np.asarray((self.statics.margins(*towers, loads) * signs >= self.min_margin).all(axis=1))

        every = self.statics.combinations(len(slots))
        own = every.find(loads)
        for _ in range(MAX_BATCHES_PER_CONFIGURATION):
            found = self.proposals(kind, len(slots), rng, fills_cells)
            kept = settled(found.falls_from, found.stands, every)[:, own].all(axis=1)
            for index in np.flatnonzero(kept).tolist():
                scene = self.scene(found.towers[OBSERVED], index, slots)
                x, y = found.offset[index].tolist()
                slot = slots[found.level[index]]
                yield scene, Remove(kind, slot) if kind == "remove_top" else Displace(kind, slot, (x, y, 0.0))

    def proposals(
        self, kind: str, num_levels: int, rng: np.random.Generator, wanted: Wanted = lambda towers, _: _every(towers)
    ) -> Proposals:
        """A batch of random towers A and do-operations whose outcomes are open.

        The cheaper of A and C is drawn, and many variants of each are tried as the other one. Where the top is removed, that is C
        and a block on top of it makes A. Otherwise it is A, and C has one of its blocks displaced.

        Args:
            kind: of do-operation.
            num_levels: of A.
            rng: what is drawn comes from it.
            wanted: only towers that it wants are proposed.
        """
        order = (COUNTERFACTUAL, OBSERVED) if kind == "remove_top" else (OBSERVED, COUNTERFACTUAL)
        drawn = self.random_towers(num_levels - (kind == "remove_top"), rng)
        kept, drawn_falls = self._open(drawn, wanted(drawn, order[0]), num_levels)
        drawn = drawn.take(kept)
        source = np.repeat(np.arange(len(kept)), NUM_VARIANTS_PER_TOWER)
        varied, level, offset = self._variants(drawn.take(source), kind, rng)
        kept, varied_falls = self._open(varied, wanted(varied, order[1]), num_levels)
        towers = drawn.take(source[kept]), varied.take(kept)
        falls_from = drawn_falls[source[kept]], varied_falls
        a, c = order.index(OBSERVED), order.index(COUNTERFACTUAL)
        stands = falls_from[c] == towers[c].xy.shape[1]
        return Proposals((towers[a], towers[c]), falls_from[a], stands, level[kept], offset[kept])

    def random_towers(self, num_levels: int, rng: np.random.Generator) -> Towers:
        """A batch of random towers, whether they stand or fall."""
        offset = self._level_offsets((NUM_TOWERS_PER_BATCH, num_levels), rng)
        offset[:, 0] = 0.0
        return Towers(np.cumsum(offset, axis=1), rng.uniform(0.0, np.pi / 2, (NUM_TOWERS_PER_BATCH, num_levels)))

    def scene(self, towers: Towers, index: int, slots: tuple[int, ...]) -> Scene:
        """One of the towers as a scene, confounders not set.

        Args:
            towers: geometries.
            index: which of them.
            slots: of its blocks, from the ground up.
        """
        return towers.scene(index, slots, block_size=self.statics.block_size, gravity_z=self.statics.gravity_z)

    def _variants(self, towers: Towers, kind: str, rng: np.random.Generator) -> tuple[Towers, np.ndarray, np.ndarray]:
        """A random change of each tower, made in place or on top: the towers, the level (tower,) and its offset (tower, 2), metres."""
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

    def _open(self, towers: Towers, wanted: np.ndarray, num_levels: int) -> tuple[np.ndarray, np.ndarray]:
        """Which of the wanted towers stand under some combinations and fall under others: indices, and their `falls_from`."""
        index = np.flatnonzero(wanted)
        falls_from = self.statics.falls_from(*towers.take(index), self.statics.combinations(num_levels))
        smallest, largest = self.stable_fraction
        share = (falls_from == towers.xy.shape[1]).mean(axis=1)
        is_open = (share >= smallest) & (share <= largest)
        return index[is_open], falls_from[is_open]


def _every(towers: Towers) -> np.ndarray:
    return np.ones(len(towers.xy), dtype=bool)


def _separable(first: Confounders, second: Confounders, *, num_levels: int) -> bool:
    """Whether towers are looked for that stand under one and fall under the other: gravity, or upper blocks' mass ratios, differ.

    Where only the lowest block's mass differs, there are some, because the ground bears that mass, too; they are not looked for.
    """
    upper = [np.array(confounders.mass[1:num_levels]) for confounders in (first, second)]
    ratios = [mass / mass[0] for mass in upper]
    return first.gravity_xy != second.gravity_xy or not np.allclose(*ratios)


def settled(falls_from: np.ndarray, stands: np.ndarray, combinations: Combinations) -> np.ndarray:
    """Whether all combinations of masses and gravity that AB cannot tell apart agree on if C stands.

    Args:
        falls_from: (tower, combination) of A, see `TowerStatics.falls_from`.
        stands: (tower, combination) bool, of C.
        combinations: of masses and gravity.

    Returns:
        (tower, combination) bool: whether an A that falls so under this combination settles it.
    """
    shown = _shown(combinations)
    group = shown[falls_from, np.arange(falls_from.shape[1])] + shown.size * np.arange(len(falls_from))[:, None]
    size = np.bincount(group.ravel())
    standing = np.bincount(group.ravel(), weights=stands.ravel())
    return np.asarray(((standing == 0) | (standing == size))[group])


def _shown(combinations: Combinations) -> np.ndarray:
    """(level + 1, combination): a number for what AB shows if the tower falls from this level; the last, if it stands."""
    count, num_levels = combinations.mass.shape
    shown = np.zeros((num_levels + 1, count), dtype=np.int64)
    for level in range(num_levels):
        falling = combinations.mass[:, level:]
        seen = np.hstack([falling / falling.max(axis=1, keepdims=True), combinations.tilt])
        shown[level] = 1 + level * count + np.unique(seen, axis=0, return_inverse=True)[1].reshape(-1)
    return shown
