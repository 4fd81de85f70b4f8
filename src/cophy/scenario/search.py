"""Search by simulation, for scenarios whose outcome no formula tells (balls, collision).

The cheapest test comes first: a scene whose observed outcomes do not tell the twins apart costs two simulations;
one that does is kept, and do-operations are tried on it until one changes both outcomes and the twins differ again.
"""

from abc import abstractmethod
from dataclasses import dataclass
from itertools import chain, repeat

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.assignment import Assignment
from cophy.scenario.experiment import DoOperation, TwinPair
from cophy.scenario.physics import Scene, Trajectory, trajectory_distance
from cophy.scenario.scenario import Scenario
from cophy.scenario.simulator import Simulator

# how hard the search tries; other values find other experiments, so raise `Scenario.search_version` with them
SCENES_PER_ROUND = (
    10  # with each second configuration in turn: some never fit, for one ball left alone tells no masses apart
)
ROUNDS = 20
DO_OPERATIONS_PER_SCENE = 3
TRIES = 100_000  # of one placement: seconds; that of six balls takes some ten


def no_room(scenario: str, what: str) -> CophyError:
    """The error of a placement that was tried `TRIES` times.

    Args:
        scenario: Its name.
        what: Is too narrow.
    """
    return CophyError(f"no {scenario} scene in {TRIES} tries: {what}")


@dataclass
class SimulatedSearch(Scenario):
    """A scenario whose twin pairs are found by simulating random scenes.

    extent: every object stays within this distance of the origin in x and y, metres.
    min_effect: the do-operation matters from this trajectory distance between B and D on, metres.
    """

    extent: float
    min_effect: float

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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.farthest_m is not None and self.min_effect > self.farthest_m:
            raise ValueError(
                f"scenario.min_effect={self.min_effect:g} m: nothing moves farther than {self.farthest_m:.3g} m"
            )

    @property
    def sight_extent_m(self) -> float:
        return self.extent

    @property
    def significant_effect_m(self) -> float:
        return self.min_effect

    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        kind = self.do_operations[assignment.do_operation]
        for second in chain.from_iterable(repeat(assignment.seconds, ROUNDS)):
            configurations = (assignment.first, second)
            for _ in range(SCENES_PER_ROUND):
                scene = self.sample_scene(assignment.cell, slots, rng)
                scenes = [self.under(configuration, scene) for configuration in configurations]
                observed = self.different_outcomes(scenes, simulator)
                if observed is None:
                    continue
                tried = [self.sample_do_operation(kind, scene, rng) for _ in range(DO_OPERATIONS_PER_SCENE)]
                for do_operation in dict.fromkeys(tried):
                    starts = [do_operation.apply(a) for a in scenes]
                    counterfactual = self.different_outcomes(starts, simulator, observed)
                    if counterfactual is not None:
                        cells = (assignment.cell, assignment.cell)
                        return TwinPair(scene, do_operation, second, observed, counterfactual, cells)
        raise CophyError(
            f"no {self.name} scene tells its twins apart where the do-operation matters: "
            "lower scenario.min_difference or scenario.min_effect, or widen scenario.extent"
        )

    def different_outcomes(
        self, scenes: list[Scene], simulator: Simulator, observed: tuple[Trajectory, Trajectory] | None = None
    ) -> tuple[Trajectory, Trajectory] | None:
        """Both twins' trajectories, if they may be kept and tell the twins apart.

        Args:
            scenes: A of both twins, or C of both.
            simulator: sequences are simulated with it.
            observed: AB of both twins where the scenes are their C. Then the do-operation has to matter under both.
        """
        found = []
        for twin, scene in enumerate(scenes):
            trajectory = self.simulate(simulator, scene)
            if not self.is_admissible(scene, trajectory):
                return None
            if observed is not None and not self.do_operation_matters(observed[twin], trajectory):
                return None
            found.append(trajectory)
        first, second = found
        return (first, second) if trajectory_distance(first, second) >= self.min_difference else None

    def do_operation_matters(self, observed: Trajectory, counterfactual: Trajectory) -> bool:
        """Whether D differs from B by `min_effect`, of the object in both that differs most: copying B is wrong."""
        return trajectory_distance(observed, counterfactual) >= self.min_effect

    def is_admissible(self, scene: Scene, trajectory: Trajectory) -> bool:
        """Whether a simulated sequence may be kept: every object stays in sight."""
        return bool(self.distance_in_sight(trajectory.positions).max() <= self.extent)

    def distance_in_sight(self, position: np.ndarray) -> np.ndarray:
        """(..., 3) -> (...) how far from the origin positions are, as `extent` counts it, metres: the larger of x and y."""
        return np.asarray(np.abs(position[..., :2]).max(axis=-1))
