"""Rigid-body simulation of scenes with PyBullet, on a client of its own.

PyBullet has wheels up to CPython 3.11 only. It is imported when a simulator is created, so that training and reports run
without it.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.physics import Body, Clock, Scene, Shape, Solver, Trajectory

BULLET_PENETRATION_THRESHOLD = -0.04  # m, Bullet's default
BULLET_CONTACT_THRESHOLD = 1e18  # Bullet's default
_STDERR = 2  # file descriptor
_MAX_CACHED = 10_000  # ours: a gigabyte at most; an oracle tries up to 2,304 configurations of a tower


class Simulator:
    """One PyBullet DIRECT client, closed on leaving the `with` block.

    Bodies use maximal coordinates (btRigidBody), at about half the cost of Bullet's multi-body on towers of three.
    `elastic_impacts` works only with these.
    """

    def __init__(self) -> None:
        self.num_simulations = 0
        self._prepared: Scene | None = None
        self._ids: list[int] = []
        self._calls = 0
        self._bullet = import_pybullet()
        self._client = self._bullet.connect(self._bullet.DIRECT)

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *error: object) -> None:
        self._bullet.disconnect(self._client)

    def simulate(self, scene: Scene, *, solver: Solver, clock: Clock, num_slots: int) -> Trajectory:
        """Simulate a scene. The bytes of the result do not depend on earlier simulations.

        Args:
            scene: Bodies at t = 0.
            solver: Its step rate must be a multiple of the clock's state rate.
            clock: Duration and sampling rates.
            num_slots: Slots of the trajectory.

        Raises:
            ValueError: The step rate is not a multiple of the state rate.
        """
        if solver.step_rate_hz % clock.state_rate_hz:
            raise ValueError(
                f"step_rate_hz={solver.step_rate_hz} is not a multiple of state_rate_hz={clock.state_rate_hz}"
            )
        bullet, client = self._bullet, self._client
        calls = self._reset(scene, solver, clock.state_rate_hz)
        self.num_simulations += 1
        ids = self._add_all(scene, solver)
        samples = [_read_states(bullet, client, ids)]
        for _ in range(clock.num_states - 1):
            for _ in range(calls):
                bullet.stepSimulation(client)
            samples.append(_read_states(bullet, client, ids))
        slots = [body.slot for body in scene.objects if body.slot is not None]
        states, presence = np.zeros((clock.num_states, num_slots, 13)), np.zeros(num_slots, dtype=bool)
        states[:, slots] = np.array(samples).reshape(clock.num_states, len(slots), 13)
        presence[slots] = True
        return Trajectory(states, presence)

    def simulate_from(
        self, scene: Scene, velocity: np.ndarray, *, frames: int, solver: Solver, frame_rate_hz: int
    ) -> np.ndarray:
        """Simulate a scene with other initial velocities, for many short runs of one scene.

        Bodies are moved back to the start, because creating them takes longer than simulating a frame. Bullet's solver
        starts from its last solution, which shifts the result by about 1e-6 m.

        Args:
            scene: Bodies at t = 0; their velocities are ignored.
            velocity: (object, 2) horizontal initial velocities, m/s.

        Returns:
            (frame, object, 6) positions and velocities of the scene's objects.
        """
        bullet, client = self._bullet, self._client
        if self._prepared != scene:
            self._calls = self._reset(scene, solver, frame_rate_hz)
            self._ids = self._add_all(scene, solver)
            self._prepared = scene
        for body_id, body, (x, y) in zip(self._ids, scene.objects, velocity.tolist(), strict=True):
            bullet.resetBasePositionAndOrientation(body_id, body.position, body.quaternion_xyzw, client)
            bullet.resetBaseVelocity(body_id, [x, y, 0.0], [0.0, 0.0, 0.0], physicsClientId=client)
        states = np.zeros((frames, len(self._ids), 6))
        for frame in range(frames):
            for _ in range(self._calls):
                bullet.stepSimulation(client)
            for index, body_id in enumerate(self._ids):
                position, _ = bullet.getBasePositionAndOrientation(body_id, client)
                linear, _ = bullet.getBaseVelocity(body_id, client)
                states[frame, index] = (*position, *linear)
        return states

    def _reset(self, scene: Scene, solver: Solver, sample_rate_hz: int) -> int:
        """Empty the world, and return the number of calls of stepSimulation from one sample to the next.

        One call makes several steps, which saves overhead: the largest power of two that divides the steps per sample.
        Then the length of a step is exact, and the result has the bytes of single steps.
        """
        bullet, client = self._bullet, self._client
        self._prepared = None
        steps = solver.step_rate_hz // sample_rate_hz
        steps_per_call = steps & -steps
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(*scene.gravity, physicsClientId=client)
        bullet.setTimeStep(steps_per_call / solver.step_rate_hz, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            numSubSteps=steps_per_call,
            numSolverIterations=solver.iterations,
            useSplitImpulse=int(solver.elastic_impacts),
            splitImpulsePenetrationThreshold=0.0 if solver.elastic_impacts else BULLET_PENETRATION_THRESHOLD,
            restitutionVelocityThreshold=0.0,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        return steps // steps_per_call

    def _add_all(self, scene: Scene, solver: Solver) -> list[int]:
        """Add all bodies, and return Bullet's ids of the objects in their order in the scene.

        All share one visual shape, a box, because otherwise Bullet computes a convex hull for each round one.
        """
        visual = self._bullet.createVisualShape(
            self._bullet.GEOM_BOX, halfExtents=[1, 1, 1], physicsClientId=self._client
        )
        ids = [self._add(body, visual, solver) for body in scene.bodies]
        return [body_id for body, body_id in zip(scene.bodies, ids, strict=True) if body.slot is not None]

    def _add(self, body: Body, visual: int, solver: Solver) -> int:
        bullet, client = self._bullet, self._client
        width, depth, height = body.size_m
        if body.shape is Shape.BOX:
            geometry = {"shapeType": bullet.GEOM_BOX, "halfExtents": [width / 2, depth / 2, height / 2]}
        elif body.shape is Shape.SPHERE:
            geometry = {"shapeType": bullet.GEOM_SPHERE, "radius": width / 2}
        else:
            geometry = {"shapeType": bullet.GEOM_CYLINDER, "radius": width / 2, "height": height}
        body_id = bullet.createMultiBody(
            baseMass=body.mass,
            baseCollisionShapeIndex=bullet.createCollisionShape(physicsClientId=client, **geometry),
            baseVisualShapeIndex=visual,
            basePosition=body.position,
            baseOrientation=body.quaternion_xyzw,
            useMaximalCoordinates=1,
            physicsClientId=client,
        )
        bullet.changeDynamics(
            body_id,
            -1,
            lateralFriction=body.friction,
            restitution=body.restitution,
            linearDamping=0.0,
            angularDamping=0.0,
            contactProcessingThreshold=0.0 if solver.elastic_impacts else BULLET_CONTACT_THRESHOLD,
            physicsClientId=client,
        )
        bullet.resetBaseVelocity(body_id, body.linear_velocity, [0.0, 0.0, 0.0], physicsClientId=client)
        return int(body_id)


def _read_states(bullet: Any, client: int, ids: list[int]) -> list[float]:
    """Return the 13 numbers of every object in turn, as in `Trajectory.states`."""
    numbers: list[float] = []
    for body_id in ids:
        position, quaternion = bullet.getBasePositionAndOrientation(body_id, client)
        linear, angular = bullet.getBaseVelocity(body_id, client)
        numbers += (*position, *quaternion, *linear, *angular)
    return numbers


def import_pybullet() -> Any:
    """Import PyBullet, or raise a CophyError that explains where it is available."""
    try:
        with nullcontext() if "pybullet" in sys.modules else _silence_stderr():
            import pybullet
    except ImportError as error:
        raise CophyError(
            "simulation and rendering need PyBullet, which has wheels up to Python 3.11 on Linux x86_64 only: "
            "generate data there and copy data/ here, or build it (docs/install.md); training and reports need no PyBullet"
        ) from error
    return pybullet


@contextmanager
def _silence_stderr() -> Iterator[None]:
    """Discard what C code writes to standard error: PyBullet prints its build time in every process."""
    saved = os.dup(_STDERR)
    try:
        with open(os.devnull, "wb") as devnull:
            os.dup2(devnull.fileno(), _STDERR)
        yield
    finally:
        os.dup2(saved, _STDERR)
        os.close(saved)


class CachingSimulator(Simulator):
    """Simulator that stores the last 10,000 trajectories, for experiments that share scenes, such as twins."""

    def __init__(self) -> None:
        super().__init__()
        self._cache: dict[tuple[Scene, str], Trajectory] = {}

    def __enter__(self) -> "CachingSimulator":
        return self

    def simulate(self, scene: Scene, *, solver: Solver, clock: Clock, num_slots: int) -> Trajectory:
        """See `Simulator.simulate`. The returned arrays are shared and must not be modified."""
        key = (scene, repr((solver, clock, num_slots)))
        if key not in self._cache:
            if len(self._cache) == _MAX_CACHED:
                del self._cache[next(iter(self._cache))]
            self._cache[key] = super().simulate(scene, solver=solver, clock=clock, num_slots=num_slots)
        return self._cache[key]

    def clear_cache(self) -> None:
        """Delete the stored trajectories."""
        self._cache.clear()
