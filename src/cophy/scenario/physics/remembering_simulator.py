"""A simulator that simulates no scene twice."""

from cophy.scenario.physics.scene import Scene, Trajectory
from cophy.scenario.physics.simulation_settings import Clock, Solver
from cophy.scenario.physics.simulator import Simulator

MOST = 10_000  # ours: a gigabyte at most; an oracle tries up to 2,304 configurations of a tower


class RememberingSimulator(Simulator):
    """Gives a scene's trajectory again where it was simulated before; for experiments that share scenes, as twins do.

    The last `MOST` trajectories stay in memory until `forget`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[tuple[Scene, str], Trajectory] = {}

    def __enter__(self) -> "RememberingSimulator":
        return self

    def simulate(self, scene: Scene, *, solver: Solver, clock: Clock, num_slots: int) -> Trajectory:
        """See `Simulator.simulate`; what is given must not be changed."""
        key = (scene, repr((solver, clock, num_slots)))
        if key not in self._known:
            if len(self._known) == MOST:
                del self._known[next(iter(self._known))]
            self._known[key] = super().simulate(scene, solver=solver, clock=clock, num_slots=num_slots)
        return self._known[key]

    def forget(self) -> None:
        """Free the memory."""
        self._known.clear()
