"""Search by simulation, for scenarios whose outcome no formula tells (balls, collision).

The cheapest test comes first: a scene whose observed outcomes do not tell the twins apart costs two simulations;
one that does is kept, and do-operations are tried on it until the counterfactual outcomes differ too.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import Assignment
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.launch import VelocityFit, with_velocities
from cophy.scenario.physics import Simulator
from cophy.scenario.scenario import Scenario, TwinPair
from cophy.scenario.scene import Scene, Trajectory, trajectory_distance

# how hard a search tries; other values find other experiments, so raise dataset.spec.FORMAT_VERSION with them
SCENES_PER_CONFIGURATION = 30
DO_OPERATIONS_PER_SCENE = 3
MOST_TRIES = 200  # per draw, when a scene is launched again


@dataclass
class SimulatedSearch(Scenario):
    """A scenario whose twin pairs are found by simulating proposals.

    extent: every object stays within this distance of the origin in x and y, metres.
    """

    extent: float

    @abstractmethod
    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        """A random scene A of the cell, confounders not set."""

    @abstractmethod
    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        """A random do-operation of this kind that the scene allows."""

    @abstractmethod
    def launch(self, scene: Scene, rng: np.random.Generator) -> np.ndarray:
        """(object, 2) horizontal initial velocities, m/s, as `sample_scene` would draw them for objects that lie so."""

    def redraw(
        self, scene: Scene, do_operation: DoOperation, draws: int, rng: np.random.Generator, simulator: Simulator
    ) -> list[Trajectory]:
        """CD of twins found as `search` does, with A and the do-operation held."""
        count, found = self.confounders.num_configurations(len(scene.objects)), list[Trajectory]()
        for _ in range(MOST_TRIES * draws):
            if len(found) >= draws:
                return found[:draws]
            launched = with_velocities(scene, self.launch(scene, rng))
            scenes = [self.under(int(c), launched) for c in rng.choice(count, 2, replace=False)]
            if self._different_outcomes(scenes, simulator) is not None:
                found += self._different_outcomes([do_operation.apply(a) for a in scenes], simulator) or ()
        raise CophyError(f"no {self.name} twins but its own fit this scene: it was not made with this configuration")

    def launcher(
        self, scene: Scene, observed: np.ndarray, rng: np.random.Generator, simulator: Simulator
    ) -> Callable[[Scene], Scene]:
        return VelocityFit(
            observed, lambda: self.launch(scene, rng), solver=self.solver, clock=self.clock, simulator=simulator
        )

    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind = self.do_operations[assignment.do_operation]
        for second in assignment.seconds:
            configurations = (assignment.first, second)
            for _ in range(SCENES_PER_CONFIGURATION):
                scene = self.sample_scene(assignment.cell, slots, rng)
                scenes = [self.under(configuration, scene) for configuration in configurations]
                observed = self._different_outcomes(scenes, simulator)
                if observed is None:
                    continue
                for _ in range(DO_OPERATIONS_PER_SCENE):
                    do_operation = self.sample_do_operation(kind, scene, rng)
                    counterfactual = self._different_outcomes([do_operation.apply(a) for a in scenes], simulator)
                    if counterfactual is not None:
                        strata = (assignment.cell, assignment.cell)
                        return TwinPair(scene, do_operation, second, observed, counterfactual, strata)
        raise CophyError(
            f"no {self.name} scene tells its twins apart: lower scenario.min_difference or widen scenario.extent"
        )

    def _different_outcomes(self, scenes: list[Scene], simulator: Simulator) -> tuple[Trajectory, Trajectory] | None:
        """Both twins' trajectories, if they are fit to be kept and differ significantly."""
        first = self.simulate(simulator, scenes[0])
        if not self.fit(scenes[0], first):
            return None
        second = self.simulate(simulator, scenes[1])
        if not self.fit(scenes[1], second) or trajectory_distance(first, second) < self.min_difference:
            return None
        return first, second

    def fit(self, scene: Scene, trajectory: Trajectory) -> bool:
        """Whether a simulated sequence may be kept: every object stays in sight."""
        return bool(np.abs(trajectory.positions[..., :2]).max() <= self.extent)
