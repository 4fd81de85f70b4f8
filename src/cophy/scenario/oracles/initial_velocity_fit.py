"""Initial velocities that bring the first frames of AB about, under any confounders: a fit through the simulator."""

import numpy as np

from cophy.scenario.physics.scene import Scene
from cophy.scenario.physics.simulation_settings import Clock, Solver
from cophy.scenario.physics.simulator import Simulator

NEAR_M = 3e-3  # what is as near to where it is seen needs no correction; what a simulation remembers of the one before matters less
MAX_CORRECTIONS = 4  # in free motion each is exact but for friction
MAX_STEP = 2.0  # m/s, of a correction
TINY = 1e-12  # what may not be divided by


class InitialVelocityFit:
    """Finds initial velocities that bring the objects of a scene to where AB shows them in the second frame.

    It starts from the true initial velocities. So the fit under the true confounders is exact, as that of an endless search
    would be. From AB alone that search is hard: where something is hit before the second frame, few starts lead to the
    truth. Under other confounders the velocities are corrected by Broyden's method: every step also corrects the derivative
    that the next one uses.

    Args:
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        velocity: (object, 2) true initial velocities, m/s.
        solver, clock: of the scenario.
        simulator: fits are simulated with it.
    """

    def __init__(
        self, observed: np.ndarray, velocity: np.ndarray, *, solver: Solver, clock: Clock, simulator: Simulator
    ) -> None:
        self.observed, self.velocity, self.solver, self.simulator = observed, velocity, solver, simulator
        self.rate = clock.frame_rate_hz

    def __call__(self, scene: Scene) -> Scene:
        """The scene with the best velocities on the way to those that reach the second frame."""
        velocity = self.velocity
        inverse = self.rate * np.eye(velocity.size)  # velocities per position: that of free motion
        miss = self._miss(scene, velocity)
        best, least = velocity, float(np.abs(miss).max())
        for _ in range(MAX_CORRECTIONS):
            if least < NEAR_M:
                break
            step = np.clip(-inverse @ miss, -MAX_STEP, MAX_STEP)
            velocity = velocity + step.reshape(velocity.shape)
            change = self._miss(scene, velocity) - miss
            miss, moved = miss + change, inverse @ change
            if abs(scale := float(step @ moved)) > TINY:
                inverse = inverse + np.outer(step - moved, step @ inverse) / scale
            if float(np.abs(miss).max()) < least:
                best, least = velocity, float(np.abs(miss).max())
        return scene.with_velocities(best)

    def _miss(self, scene: Scene, velocity: np.ndarray) -> np.ndarray:
        """(2 objects,) simulated minus seen positions in the second frame, m."""
        simulated = self.simulator.simulate_from(scene, velocity, frames=1, solver=self.solver, frame_rate_hz=self.rate)
        slots = [body.slot for body in scene.objects if body.slot is not None]
        return np.asarray(simulated[0, :, :2] - self.observed[1, slots, :2]).ravel()
