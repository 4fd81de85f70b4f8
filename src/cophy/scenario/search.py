"""Search by simulation, for scenarios without a formula for their outcomes (balls, collision).

The cheapest test comes first: two simulations show whether the observed outcomes of the twins differ. If they do,
do-operations are tried on the scene until one changes both outcomes and the twins differ again.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from itertools import chain, repeat

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import PairAssignment
from cophy.scenario.experiment import DoOperation, TwinPair
from cophy.scenario.physics import Scene, Trajectory, largest_energy_gain, trajectory_distance
from cophy.scenario.scenario import Scenario
from cophy.scenario.simulator import Simulator

# Effort of the search. Other values give other experiments, so increase `Scenario.search_version` with them.
SCENES_PER_ROUND = 10  # per second configuration, in turn: some never fit, because a single ball does not show its mass
ROUNDS = 20
DO_OPERATIONS_PER_SCENE = 3
MAX_PLACEMENTS = 100_000  # takes seconds; six balls need about ten


def placement_error(scenario: str, reason: str) -> CophyError:
    """Return the error of a placement that failed `MAX_PLACEMENTS` times."""
    return CophyError(f"no {scenario} scene after {MAX_PLACEMENTS} attempts: {reason}")


@dataclass
class SimulatedSearch(Scenario):
    """A scenario whose twin pairs are found by simulating random scenes.

    Attributes:
        extent: Every object stays within this distance of the origin in x and y, metres.
        min_effect: Smallest trajectory distance between B and D, metres.
    """

    extent: float
    min_effect: float

    @abstractmethod
    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        """Sample a scene A, without confounders.

        Args:
            cell: Index into `cells`.
            slots: Slots of the objects, in the scenario's own order.
        """

    @abstractmethod
    def sample_velocities(self, scene: Scene, rng: np.random.Generator) -> np.ndarray:
        """Sample (object, 2) initial horizontal velocities, m/s, given the places of the objects in A, as `sample_scene` does."""

    @abstractmethod
    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        """Sample a do-operation that the scene allows.

        Args:
            kind: One of the scenario's `do_operations`.
            scene: A.
        """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_distance("min_effect", self.min_effect)

    @property
    def farthest_m(self) -> float:
        return 2 * math.sqrt(2) * self.extent

    @property
    def significant_effect_m(self) -> float:
        return self.min_effect

    def search(
        self, assignment: PairAssignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind = self.do_operations[assignment.do_operation]
        for second in chain.from_iterable(repeat(assignment.seconds, ROUNDS)):
            configurations = (assignment.first, second)
            for _ in range(SCENES_PER_ROUND):
                scene = self.sample_scene(assignment.cell, slots, rng)
                scenes = [self.with_configuration(configuration, scene) for configuration in configurations]
                observed = self.simulate_twins(scenes, simulator)
                if observed is None:
                    continue
                candidates = [self.sample_do_operation(kind, scene, rng) for _ in range(DO_OPERATIONS_PER_SCENE)]
                for do_operation in dict.fromkeys(candidates):
                    starts = [do_operation.apply(a) for a in scenes]
                    counterfactual = self.simulate_twins(starts, simulator, observed)
                    if counterfactual is not None:
                        cells = (assignment.cell, assignment.cell)
                        return TwinPair(scene, do_operation, second, observed, counterfactual, cells)
        raise CophyError(
            f"no {self.name} scene has twins that differ in both outcomes and a do-operation that matters: "
            "lower scenario.min_difference or scenario.min_effect, or widen scenario.extent"
        )

    def simulate_twins(
        self, scenes: list[Scene], simulator: Simulator, observed: tuple[Trajectory, Trajectory] | None = None
    ) -> tuple[Trajectory, Trajectory] | None:
        """Simulate both twins, and return their trajectories if these are admissible and differ, otherwise None.

        Args:
            scenes: A of both twins, or C of both.
            observed: AB of both twins if the scenes are C. Then the do-operation must matter for both.
        """
        trajectories = []
        for twin, scene in enumerate(scenes):
            trajectory = self.simulate(simulator, scene)
            if not self.is_admissible(scene, trajectory):
                return None
            if observed is not None and not self.do_operation_matters(observed[twin], trajectory):
                return None
            trajectories.append(trajectory)
        first, second = trajectories
        return (first, second) if trajectory_distance(first, second) >= self.min_difference else None

    def do_operation_matters(self, observed: Trajectory, counterfactual: Trajectory) -> bool:
        """Return whether D differs from B by `min_effect` (of the object that differs most), so that copying B is wrong."""
        return trajectory_distance(observed, counterfactual) >= self.min_effect

    def is_admissible(self, scene: Scene, trajectory: Trajectory) -> bool:
        """Return whether all objects stay within `extent` and no impact that the solver resolves wrongly adds energy.

        The limit is the field `max_energy_gain` of the scenario, if it has one.
        """
        within = bool(self.distance_from_origin(trajectory.positions).max() <= self.extent)
        return within and largest_energy_gain(scene, trajectory) <= getattr(self, "max_energy_gain", math.inf)

    def distance_from_origin(self, position: np.ndarray) -> np.ndarray:
        """Return the (...) distances of (..., 3) positions from the origin for `extent`, metres: the larger absolute value of x and y."""
        return np.asarray(np.abs(position[..., :2]).max(axis=-1))
