"""Initial velocities from the first frames of AB, by fitting through the simulator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cophy.scenario.physics.scene import Scene
from cophy.scenario.physics.simulation_settings import Clock, Solver
from cophy.scenario.physics.simulator import Simulator

MAX_MISS_M = 0.3  # an object that is off by more hit something else: other confounders move it less
NUM_COMPARED_FRAMES = 3  # that velocities are compared by; the first alone can be reached in several ways
NUM_CORRECTIONS = 6  # in free motion each is exact but for friction
MAX_EVALUATIONS = 30  # of a root search
SQUARED_RELATIVE_STEP = 1e-6  # of a root search, far above what a simulation remembers
MAX_RANDOM_SEARCHES = 3  # how often an experiment is searched for other starts,
NUM_RANDOM_STARTS = 96  # among how many velocities,
NUM_TRIED_STARTS = 4  # and how many of them are tried


class InitialVelocityFit:
    """Finds initial velocities that bring the objects of a scene to where AB shows them in the second frame.

    The scene may have any confounders. Where nothing is hit before the second frame, a few corrections of the mean
    velocity are enough. Otherwise a root search starts from the velocities that fitted under other confounders. A few
    times it also starts from the best of many random velocities.

    Args:
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        draw: draws velocities (object, 2), m/s, as the scenario does.
        solver, clock: of the scenario.
        simulator: fits are simulated with it.
    """

    def __init__(
        self,
        observed: np.ndarray,
        draw: Callable[[], np.ndarray],
        *,
        solver: Solver,
        clock: Clock,
        simulator: Simulator,
    ) -> None:
        self.observed, self.draw, self.solver, self.simulator = observed, draw, solver, simulator
        self.rate = clock.frame_rate_hz
        self.starts: list[np.ndarray] = []
        self.random_searches_left = MAX_RANDOM_SEARCHES

    def __call__(self, scene: Scene) -> Scene:
        """The scene with the best velocities that were found."""
        found = [self._corrected(scene)]
        if self._far(scene, found[0]).any():
            found += [self._solved(scene, start) for start in self._best(scene, self.starts, NUM_TRIED_STARTS // 2)]
        best = self._best(scene, found, 1)[0]
        if self.random_searches_left and (far := self._far(scene, best)).any():
            self.random_searches_left -= 1
            random = [np.where(far[:, None], self.draw(), best) for _ in range(NUM_RANDOM_STARTS)]
            starts = self._best(scene, [self._reversed(scene), *random], NUM_TRIED_STARTS)
            best = self._best(scene, [best, *(self._solved(scene, start) for start in starts)], 1)[0]
        self.starts.append(best)
        return scene.with_velocities(best)

    def _corrected(self, scene: Scene) -> np.ndarray:
        velocity = (self._seen(scene, 1) - self._seen(scene, 0)) * self.rate
        for _ in range(NUM_CORRECTIONS):
            velocity = velocity - self._difference(scene, velocity, 1)[0] * self.rate
        return np.asarray(velocity)

    def _solved(self, scene: Scene, start: np.ndarray) -> np.ndarray:
        from scipy.optimize import root  # here: half a second that every command would spend at its start

        def difference(flat: np.ndarray) -> np.ndarray:
            return self._difference(scene, flat.reshape(start.shape), 1).ravel()

        return np.asarray(
            root(
                difference, start.ravel(), options={"maxfev": MAX_EVALUATIONS, "eps": SQUARED_RELATIVE_STEP}
            ).x.reshape(start.shape)
        )

    def _best(self, scene: Scene, velocities: list[np.ndarray], count: int) -> list[np.ndarray]:
        def badness(velocity: np.ndarray) -> float:
            return float(np.square(self._difference(scene, velocity, NUM_COMPARED_FRAMES)).sum())

        return sorted(velocities, key=badness)[:count]

    def _far(self, scene: Scene, velocity: np.ndarray) -> np.ndarray:
        """(object,) which objects are not where they are seen."""
        return np.asarray(
            (np.abs(self._difference(scene, velocity, NUM_COMPARED_FRAMES)) > MAX_MISS_M).any(axis=(0, 2))
        )

    def _reversed(self, scene: Scene) -> np.ndarray:
        """A start value for the fit: simulate backwards from frame 1 and reverse the velocity.

        Accurate where little energy is lost.
        """
        back = scene
        for body, (x, y) in zip(scene.objects, self._seen(scene, 1).tolist(), strict=True):
            back = back.with_object(replace(body, position=(x, y, body.position[2])))
        velocity = (self._seen(scene, 1) - self._seen(scene, 2)) * self.rate
        return -self._simulated(back, velocity, 1)[0, :, 3:5]

    def _difference(self, scene: Scene, velocity: np.ndarray, frames: int) -> np.ndarray:
        """(frame, object, 2) simulated minus seen positions in frames 1 ... `frames`, m."""
        seen = np.stack([self._seen(scene, frame) for frame in range(1, frames + 1)])
        return np.asarray(self._simulated(scene, velocity, frames)[..., :2] - seen)

    def _simulated(self, scene: Scene, velocity: np.ndarray, frames: int) -> np.ndarray:
        return self.simulator.simulate_from(scene, velocity, frames=frames, solver=self.solver, frame_rate_hz=self.rate)

    def _seen(self, scene: Scene, frame: int) -> np.ndarray:
        slots = [body.slot for body in scene.objects if body.slot is not None]
        return np.asarray(self.observed[frame, slots, :2])
