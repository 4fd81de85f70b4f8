"""BlocktowerCF (paper Sec. 3): stacked cubes that stand or fall, found by statics on paper, then simulated.

Friction only matters for how a tower falls, so `tower_margins` tells in microseconds, for every combination of
masses and gravity, whether A and C stand. The search looks for geometries whose outcomes are open, lets the two
prescribed configurations fill their cells, and only then simulates the four sequences that are kept anyway.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import Assignment
from cophy.scenario.confounders import Confounders
from cophy.scenario.do_operations import Displace, DoOperation, Remove
from cophy.scenario.physics import Simulator
from cophy.scenario.scenario import Scenario, TwinPair
from cophy.scenario.scene import Body, Scene, Shape, Trajectory, trajectory_distance
from cophy.scenario.stability import tower_margins
from cophy.scenario.surroundings import floor
from cophy.scenario.symmetry import square
from cophy.scenario.tower_prior import tower_prior

# how hard a search tries; other values find other experiments, so raise dataset.spec.FORMAT_VERSION with them
TOWERS_PER_BATCH = 1024
VARIANTS_PER_TOWER = 48
BATCHES_PER_CONFIGURATION = 40

Configurations = tuple[np.ndarray, np.ndarray]  # masses (configuration, level) kg; tilt of gravity (configuration, 2)


class Towers(NamedTuple):
    """Geometries. xy: (tower, level, 2) block centres, m; yaw: (tower, level), rad; levels from the ground up."""

    xy: np.ndarray
    yaw: np.ndarray

    def take(self, index: np.ndarray) -> "Towers":
        """Some of them."""
        return Towers(self.xy[index], self.yaw[index])


class Proposals(NamedTuple):
    """Towers A and C. stands: (proposal, 2, combination) bool, of A and C under `combinations`; what is displaced: level, offset (m)."""

    towers: tuple[Towers, Towers]
    stands: np.ndarray
    level: np.ndarray
    offset: np.ndarray


# (A stands, C stands) of the first twin; the second has the opposite outcome in both
CELLS = ((True, True), (False, False), (True, False), (False, True))


def outcome_kind(cell: tuple[bool, bool]) -> int:
    """Which column of `Blocktower.agreement` counts for a cell: 0 where A and C do the same, 1 where they differ."""
    return int(cell[0] != cell[1])


@dataclass
class Blocktower(Scenario):
    """Fields of conf/scenario/blocktower.yaml beyond those of every scenario."""

    block_size: float
    max_level_offset: float  # of a block's centre from the one below, along each axis
    displacement: list[float]  # smallest and largest
    min_margin: float  # both twins' towers are this far from toppling, or from standing
    stable_fraction: list[float]  # share of all configurations under which A, and C, must stand: smallest, largest
    min_agreement: float  # share of the configurations under which A stands that must give the standing twin's CD
    fallen_distance: float  # a tower has fallen once a block is this far from where it started

    @classmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        return ("displace_x", "displace_y", "remove_top")

    @classmethod
    def strata(cls) -> tuple[str, ...]:
        return tuple(f"{_word(observed)}_{_word(counterfactual)}" for observed, counterfactual in CELLS)

    @classmethod
    def num_cells(cls) -> int:
        return len(CELLS)

    @classmethod
    def symmetries(cls) -> np.ndarray:
        return square()

    @property
    def object_size_m(self) -> float:
        return self.block_size

    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind = self.do_operations[assignment.do_operation]
        first = self.confounders.decode(assignment.first, len(slots))
        cell = CELLS[assignment.cell]
        opposite = (not cell[0], not cell[1])
        for second in assignment.seconds:
            pair = (first, self.confounders.decode(second, len(slots)))
            if not _separable(*pair, num_levels=len(slots) - (kind == "remove_top")):
                continue
            for scene, do_operation in self._proposals(pair, cell, kind, slots, rng):
                scenes = [self.under(configuration, scene) for configuration in (assignment.first, second)]
                observed = [self.simulate(simulator, a) for a in scenes]
                counterfactual = [self.simulate(simulator, do_operation.apply(a)) for a in scenes]
                stands = [(self.stands(b), self.stands(d)) for b, d in zip(observed, counterfactual, strict=True)]
                different = min(trajectory_distance(*observed), trajectory_distance(*counterfactual))
                if stands == [cell, opposite] and different >= self.min_difference:
                    strata = (CELLS.index(cell), CELLS.index(opposite))
                    return TwinPair(scene, do_operation, second, tuple(observed), tuple(counterfactual), strata)  # type: ignore[arg-type]
        raise CophyError("no tower fits: widen scenario.max_level_offset or scenario.stable_fraction")

    def stands(self, trajectory: Trajectory) -> bool:
        """Whether no block ever left its place by more than `fallen_distance`."""
        moved = np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=-1)
        return bool(moved.max() < self.fallen_distance)

    def redraw(
        self, scene: Scene, do_operation: DoOperation, draws: int, rng: np.random.Generator, simulator: Simulator
    ) -> list[Trajectory]:
        prior = self.prior(scene, do_operation)
        drawn, counts = np.unique(rng.choice(len(prior), draws, p=prior), return_counts=True)
        found = [self.simulate(simulator, do_operation.apply(self.under(int(c), scene))) for c in drawn]
        return [trajectory for trajectory, count in zip(found, counts, strict=True) for _ in range(count)]

    def prior(self, scene: Scene, do_operation: DoOperation) -> np.ndarray:
        """(configuration,) as the search has it, see `tower_prior`."""
        num_levels = len(scene.objects)
        towers = (_geometry(scene), _geometry(do_operation.apply(scene)))
        probability = tower_prior(self, self._kind(do_operation), num_levels)(towers)[0]
        return self.confounders.spread(probability, num_levels)

    def _kind(self, do_operation: DoOperation) -> str:
        if isinstance(do_operation, Remove):
            return "remove_top"
        return "displace_x" if do_operation.offset_m[0] else "displace_y"

    def _proposals(
        self,
        pair: tuple[Confounders, Confounders],
        cell: tuple[bool, bool],
        kind: str,
        slots: tuple[int, ...],
        rng: np.random.Generator,
    ) -> Iterator[tuple[Scene, DoOperation]]:
        """Scenes A and do-operations that fill the cell for the first twin and its opposite for the second."""
        twins = (np.array([c.mass for c in pair]), np.array([c.gravity_xy for c in pair]) / -self.gravity_z)

        def fills(towers: Towers, sequence: int) -> np.ndarray:
            margins = self.margins(towers, twins) * np.where([cell[sequence], not cell[sequence]], 1.0, -1.0)
            return np.asarray((margins >= self.min_margin).all(axis=1))

        for _ in range(BATCHES_PER_CONFIGURATION):
            found = self.proposals(kind, len(slots), rng, fills)
            for index in np.flatnonzero(self.agreement(found.stands)[:, outcome_kind(cell)] >= self.min_agreement):
                scene = self._scene(found.towers[0].xy[index], found.towers[0].yaw[index], slots)
                if kind == "remove_top":
                    yield scene, Remove(slots[-1])
                else:
                    x, y = found.offset[index]
                    yield scene, Displace(slots[found.level[index]], (float(x), float(y), 0.0))

    def proposals(
        self,
        kind: str,
        num_levels: int,
        rng: np.random.Generator,
        keep: Callable[[Towers, int], np.ndarray] = lambda towers, sequence: np.ones(len(towers.xy), dtype=bool),
    ) -> "Proposals":
        """A batch of random towers A and do-operations whose outcomes are open, and that `keep` keeps as AB (0) and CD (1)."""
        everything = self.combinations(num_levels)
        removes = kind == "remove_top"  # then the cheaper tower is C, and a top block is put on it to make A
        drawn = self._towers(num_levels - removes, rng)
        drawn = drawn.take(keep(drawn, int(removes)))
        drawn_stands = self.margins(drawn, everything) > 0
        fits = self._is_open(drawn_stands)
        drawn, drawn_stands = drawn.take(fits), drawn_stands[fits]
        level, offset, source = self._variants(kind, len(drawn.xy), num_levels, rng)
        varied = drawn.take(source)
        if removes:
            top_yaw = rng.uniform(0.0, np.pi / 2, (len(source), 1))
            top = varied.xy[:, -1:] + offset[:, None]
            varied = Towers(np.concatenate([varied.xy, top], axis=1), np.concatenate([varied.yaw, top_yaw], axis=1))
        else:
            varied.xy[np.arange(len(source)), level] += offset
        fits = np.flatnonzero(keep(varied, int(not removes)))
        stands = self.margins(varied.take(fits), everything) > 0
        fits, stands = fits[self._is_open(stands)], stands[self._is_open(stands)]
        both = (varied.take(fits), drawn.take(source[fits])), (stands, drawn_stands[source[fits]])
        towers, outcomes = both if removes else (both[0][::-1], both[1][::-1])
        return Proposals(towers, np.stack(outcomes, axis=1), level[fits], offset[fits])

    def combinations(self, num_levels: int) -> Configurations:
        """Every combination of masses and gravity."""
        mass, gravity_xy = self.confounders.masses_and_gravities(num_levels)
        return mass, gravity_xy / -self.gravity_z

    def margins(self, towers: Towers, configurations: Configurations) -> np.ndarray:
        """(tower, configuration) metres, see `tower_margins`; of towers that lost their top, the masses of what is left count."""
        mass, tilt = configurations
        return tower_margins(*towers, mass[:, : towers.xy.shape[1]], tilt, size_m=self.block_size)

    def agreement(self, stands: np.ndarray) -> np.ndarray:
        """Of the combinations under which A stands, the share under which C stands, and the share under which it falls.

        stands: (geometry, 2, combination), of A and C. Returns (geometry, 2).
        """
        observed, counterfactual = stands[:, 0], stands[:, 1]
        share = (observed & counterfactual).sum(axis=1) / observed.sum(axis=1)
        return np.stack([share, 1 - share], axis=1)

    def _towers(self, num_levels: int, rng: np.random.Generator) -> Towers:
        offset = self._level_offsets((TOWERS_PER_BATCH, num_levels), rng)
        offset[:, 0] = 0.0
        return Towers(np.cumsum(offset, axis=1), rng.uniform(0.0, np.pi / 2, (TOWERS_PER_BATCH, num_levels)))

    def _level_offsets(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(-self.max_level_offset, self.max_level_offset, (*shape, 2))

    def _variants(
        self, kind: str, num_drawn: int, num_levels: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Candidate changes of each drawn tower: the level concerned, its offset (x, y), and the tower's index."""
        source = np.repeat(np.arange(num_drawn), VARIANTS_PER_TOWER)
        if kind == "remove_top":
            return np.full(len(source), num_levels - 1), self._level_offsets((len(source),), rng), source
        distance = rng.uniform(self.displacement[0], self.displacement[1], len(source)) * rng.choice(
            [-1.0, 1.0], len(source)
        )
        axis = np.array([0.0, 1.0] if kind == "displace_y" else [1.0, 0.0])
        return rng.integers(num_levels, size=len(source)), distance[:, None] * axis, source

    def _is_open(self, stands: np.ndarray) -> np.ndarray:
        smallest, largest = self.stable_fraction
        return (stands.mean(axis=1) >= smallest) & (stands.mean(axis=1) <= largest)

    def _scene(self, xy: np.ndarray, yaw: np.ndarray, slots: tuple[int, ...]) -> Scene:
        size = self.block_size
        blocks = tuple(
            Body(
                Shape.BOX,
                (size, size, size),
                position=(float(xy[level, 0]), float(xy[level, 1]), (level + 0.5) * size),
                quaternion_xyzw=(0.0, 0.0, float(np.sin(yaw[level] / 2)), float(np.cos(yaw[level] / 2))),
                slot=slot,
                mass=1.0,
            )
            for level, slot in enumerate(slots)
        )
        return Scene((floor(), *blocks), gravity=(0.0, 0.0, self.gravity_z))


def _separable(first: Confounders, second: Confounders, *, num_levels: int) -> bool:
    """Whether some tower stands under one and falls under the other: gravity differs, or the upper blocks' mass ratios."""
    upper = [np.array(confounders.mass[1:num_levels]) for confounders in (first, second)]
    ratios = [mass / mass[0] for mass in upper]
    return first.gravity_xy != second.gravity_xy or not np.allclose(*ratios)


def _geometry(scene: Scene) -> Towers:
    blocks = scene.objects
    yaw = [2 * np.arctan2(block.quaternion_xyzw[2], block.quaternion_xyzw[3]) for block in blocks]
    return Towers(np.array([[block.position[:2] for block in blocks]]), np.array([yaw]))


def _word(stands: bool) -> str:
    return "stands" if stands else "falls"
