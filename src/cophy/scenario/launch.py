"""Initial velocities from the first frames of AB, by fitting through the simulator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cophy.scenario.physics import Clock, Simulator, Solver
from cophy.scenario.scene import Scene

FAR = 0.3  # m; an object that is off by more hit something else: other confounders move it less
FRAMES = 3  # that velocities are compared by; the first alone can be reached in several ways
CORRECTIONS = 6  # in free motion each is exact but for friction
EVALUATIONS = 30  # of a root search
STEP = 1e-6  # square of its relative step, far above what a simulation remembers
SEARCHES = 3  # how often an experiment is searched for other starts,
LAUNCHES = 96  # in how many launches,
TRIED = 4  # and how many of them are tried


def with_velocities(scene: Scene, velocity: np.ndarray) -> Scene:
    """The scene with its objects' initial velocities, (object, 2) horizontal m/s, in the scenario's own order."""
    for body, (vx, vy) in zip(scene.objects, velocity.tolist(), strict=True):
        scene = scene.with_object(replace(body, linear_velocity=(vx, vy, 0.0)))
    return scene


class VelocityFit:
    """Launches a scene so that its objects are in the second frame where AB shows them, whatever the confounders.

    observed: (T, K, 3) positions of AB at the frame rate, m. launch: draws velocities (object, 2) as the scenario does.
    Where nothing is hit within the first frame, a few corrections of the mean velocity settle it. Otherwise a root search starts from the
    velocities that fitted under other confounders, and, a few times, from the best of many random launches.
    """

    def __init__(
        self,
        observed: np.ndarray,
        launch: Callable[[], np.ndarray],
        *,
        solver: Solver,
        clock: Clock,
        simulator: Simulator,
    ) -> None:
        self.observed, self.launch, self.solver, self.simulator = observed, launch, solver, simulator
        self.rate = clock.frame_rate_hz
        self.starts: list[np.ndarray] = []
        self.searches = SEARCHES

    def __call__(self, scene: Scene) -> Scene:
        """The scene, launched as well as was found."""
        found = [self._corrected(scene)]
        if self._far(scene, found[0]).any():
            found += [self._solved(scene, start) for start in self._best(scene, self.starts, TRIED // 2)]
        best = self._best(scene, found, 1)[0]
        if self.searches and (far := self._far(scene, best)).any():
            self.searches -= 1
            random = [np.where(far[:, None], self.launch(), best) for _ in range(LAUNCHES)]
            starts = self._best(scene, [self._reversed(scene), *random], TRIED)
            best = self._best(scene, [best, *(self._solved(scene, start) for start in starts)], 1)[0]
        self.starts.append(best)
        return with_velocities(scene, best)

    def _corrected(self, scene: Scene) -> np.ndarray:
        velocity = (self._seen(scene, 1) - self._seen(scene, 0)) * self.rate
        for _ in range(CORRECTIONS):
            velocity = velocity - self._difference(scene, velocity, 1)[0] * self.rate
        return np.asarray(velocity)

    def _solved(self, scene: Scene, start: np.ndarray) -> np.ndarray:
        from scipy.optimize import root  # here: half a second that every command would spend at its start

        def difference(flat: np.ndarray) -> np.ndarray:
            return self._difference(scene, flat.reshape(start.shape), 1).ravel()

        return np.asarray(
            root(difference, start.ravel(), options={"maxfev": EVALUATIONS, "eps": STEP}).x.reshape(start.shape)
        )

    def _best(self, scene: Scene, velocities: list[np.ndarray], count: int) -> list[np.ndarray]:
        def badness(velocity: np.ndarray) -> float:
            return float(np.square(self._difference(scene, velocity, FRAMES)).sum())

        return sorted(velocities, key=badness)[:count]

    def _far(self, scene: Scene, velocity: np.ndarray) -> np.ndarray:
        """(object,) which objects are not where they are seen."""
        return np.asarray((np.abs(self._difference(scene, velocity, FRAMES)) > FAR).any(axis=(0, 2)))

    def _reversed(self, scene: Scene) -> np.ndarray:
        """What motion back in time from the next frame would arrive with: near enough where little energy is lost."""
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
        return self.simulator.launch(scene, velocity, frames=frames, solver=self.solver, frame_rate_hz=self.rate)

    def _seen(self, scene: Scene, frame: int) -> np.ndarray:
        slots = [body.slot for body in scene.objects if body.slot is not None]
        return np.asarray(self.observed[frame, slots, :2])
