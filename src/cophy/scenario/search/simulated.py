"""Search by simulation, for scenarios whose outcome no formula tells (balls, collision).

The cheapest test comes first: a scene whose observed outcomes do not tell the twins apart costs two simulations;
one that does is kept, and do-operations are tried on it until the counterfactual outcomes differ too.
"""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.experiment import TwinPair
from cophy.scenario.physics.scene import Scene, Trajectory, trajectory_distance
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario
from cophy.scenario.search.assignment import Assignment

# how hard the search tries; other values find other experiments, so raise dataset.spec.FORMAT_VERSION with them
MAX_SCENES_PER_CONFIGURATION = 30
MAX_DO_OPERATIONS_PER_SCENE = 3


@dataclass
class SimulatedSearch(Scenario):
    """A scenario whose twin pairs are found by simulating random scenes.

    extent: every object stays within this distance of the origin in x and y, metres.
    """

    extent: float

    @abstractmethod
    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        """A random scene A, confounders not set.

        Args:
            cell: index into `cells`.
            slots: of the objects, in the scenario's own order.
            rng: all that is random comes from it.
        """

    @abstractmethod
    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        """A random do-operation that the scene allows.

        Args:
            kind: one of the scenario's `do_operations`.
            scene: A.
            rng: all that is random comes from it.
        """

    @property
    def sight_extent_m(self) -> float:
        return self.extent

    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind = self.do_operations[assignment.do_operation]
        for second in assignment.seconds:
            configurations = (assignment.first, second)
            for _ in range(MAX_SCENES_PER_CONFIGURATION):
                scene = self.sample_scene(assignment.cell, slots, rng)
                scenes = [self.under(configuration, scene) for configuration in configurations]
                observed = self.different_outcomes(scenes, simulator)
                if observed is None:
                    continue
                for _ in range(MAX_DO_OPERATIONS_PER_SCENE):
                    do_operation = self.sample_do_operation(kind, scene, rng)
                    counterfactual = self.different_outcomes([do_operation.apply(a) for a in scenes], simulator)
                    if counterfactual is not None:
                        cells = (assignment.cell, assignment.cell)
                        return TwinPair(scene, do_operation, second, observed, counterfactual, cells)
        raise CophyError(
            f"no {self.name} scene tells its twins apart: lower scenario.min_difference or widen scenario.extent"
        )

    def different_outcomes(self, scenes: list[Scene], simulator: Simulator) -> tuple[Trajectory, Trajectory] | None:
        """Both twins' trajectories, if they are admissible and differ significantly."""
        first = self.simulate(simulator, scenes[0])
        if not self.is_admissible(scenes[0], first):
            return None
        second = self.simulate(simulator, scenes[1])
        if not self.is_admissible(scenes[1], second) or trajectory_distance(first, second) < self.min_difference:
            return None
        return first, second

    def is_admissible(self, scene: Scene, trajectory: Trajectory) -> bool:
        """Whether a simulated sequence may be kept: every object stays in sight."""
        return bool(np.abs(trajectory.positions[..., :2]).max() <= self.extent)
