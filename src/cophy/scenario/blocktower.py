"""BlocktowerCF (paper Sec. 3): stacked cubes that stand or fall, found by statics on paper, then simulated.

Friction only matters for how a tower falls, so `tower_margins` tells in microseconds, for every combination of
masses and gravity, whether A and C stand. The search looks for geometries whose outcomes are open, lets the two
prescribed configurations fill their cells, and only then simulates the four sequences that are kept anyway.
"""

from collections.abc import Iterator
from dataclasses import dataclass

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

# how hard a search tries; other values find other experiments, so raise dataset.spec.FORMAT_VERSION with them
TOWERS_PER_BATCH = 1024
VARIANTS_PER_TOWER = 48
BATCHES_PER_CONFIGURATION = 40

Configurations = tuple[np.ndarray, np.ndarray]  # masses (configuration, level) kg; tilt of gravity (configuration, 2)

# (A stands, C stands) of the first twin; the second has the opposite outcome in both
CELLS = ((True, True), (False, False), (True, False), (False, True))


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
        mass, gravity_xy = self.confounders.masses_and_gravities(len(slots))
        everything = (mass, gravity_xy / -self.gravity_z)
        removes = kind == "remove_top"
        # the cheaper tower is drawn first: A, or the C that a top block is put on to make A
        drawn_stands, varied_stands = reversed(cell) if removes else cell
        for _ in range(BATCHES_PER_CONFIGURATION):
            xy, yaw = self._towers(len(slots) - removes, rng)
            fits = self._fills(xy, yaw, twins, first_stands=drawn_stands)
            xy, yaw = xy[fits], yaw[fits]
            drawn = self._stands(xy, yaw, everything)
            fits = self._is_open(drawn)
            xy, yaw, drawn = xy[fits], yaw[fits], drawn[fits]
            level, offset, source = self._variants(kind, len(xy), len(slots), rng)
            if removes:
                top_yaw = rng.uniform(0.0, np.pi / 2, (len(source), 1))
                varied_xy = np.concatenate([xy[source], xy[source, -1:] + offset[:, None]], axis=1)
                varied_yaw = np.concatenate([yaw[source], top_yaw], axis=1)
            else:
                varied_xy, varied_yaw = xy[source], yaw[source]
                varied_xy[np.arange(len(source)), level] += offset
            fits = np.flatnonzero(self._fills(varied_xy, varied_yaw, twins, first_stands=varied_stands))
            varied = self._stands(varied_xy[fits], varied_yaw[fits], everything)
            fits, varied = fits[self._is_open(varied)], varied[self._is_open(varied)]
            observed, counterfactual = (varied, drawn[source[fits]]) if removes else (drawn[source[fits]], varied)
            for index in fits[self._agreement(observed, counterfactual, cell) >= self.min_agreement]:
                if removes:
                    yield self._scene(varied_xy[index], varied_yaw[index], slots), Remove(slots[-1])
                else:
                    x, y = offset[index]
                    scene = self._scene(xy[source[index]], yaw[source[index]], slots)
                    yield scene, Displace(slots[level[index]], (float(x), float(y), 0.0))

    def _towers(self, num_levels: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        offset = self._level_offsets((TOWERS_PER_BATCH, num_levels), rng)
        offset[:, 0] = 0.0
        return np.cumsum(offset, axis=1), rng.uniform(0.0, np.pi / 2, (TOWERS_PER_BATCH, num_levels))

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

    def _margins(self, xy: np.ndarray, yaw: np.ndarray, configurations: Configurations) -> np.ndarray:
        mass, tilt = configurations
        return tower_margins(xy, yaw, mass[:, : xy.shape[1]], tilt, size_m=self.block_size)

    def _stands(self, xy: np.ndarray, yaw: np.ndarray, configurations: Configurations) -> np.ndarray:
        return self._margins(xy, yaw, configurations) > 0

    def _fills(self, xy: np.ndarray, yaw: np.ndarray, twins: Configurations, *, first_stands: bool) -> np.ndarray:
        margins = self._margins(xy, yaw, twins) * np.where([first_stands, not first_stands], 1.0, -1.0)
        return np.asarray((margins >= self.min_margin).all(axis=1))

    def _agreement(self, observed: np.ndarray, counterfactual: np.ndarray, cell: tuple[bool, bool]) -> np.ndarray:
        """Share of the configurations under which A stands that share the CD of the twin whose A stands."""
        outcome = cell[1] if cell[0] else not cell[1]
        return (observed & (counterfactual == outcome)).sum(axis=1) / observed.sum(axis=1)

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


def _word(stands: bool) -> str:
    return "stands" if stands else "falls"
