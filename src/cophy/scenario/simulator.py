"""A simulator that simulates no scene twice.

Scene -> Trajectory: rigid-body simulation with PyBullet on a client that is owned, never global.

PyBullet has wheels up to CPython 3.11 only; it is imported when a simulator is made, so that training and
reports run without it.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import TracebackType
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.physics import Body, Clock, Scene, Shape, Solver, Trajectory

BULLET_PENETRATION_THRESHOLD = -0.04  # m; Bullet's defaults
BULLET_CONTACT_THRESHOLD = 1e18
STANDARD_ERROR = 2  # its file descriptor


class Simulator:
    """One PyBullet DIRECT client, closed on leaving the `with` block.

    Bodies use maximal coordinates (btRigidBody): about half the cost of Bullet's multi-body on towers of three, and
    `elastic_impacts` has its effect only there.
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bullet.disconnect(self._client)

    def simulate(self, scene: Scene, *, solver: Solver, clock: Clock, num_slots: int) -> Trajectory:
        """Simulate a scene from t = 0. The same scene gives the same bytes whatever was simulated before.

        Args:
            scene: what is simulated.
            solver: its step rate must be a multiple of the clock's state rate.
            clock: how long, and how often states are sampled.
            num_slots: of the trajectory.

        Raises:
            ValueError: the two rates do not fit.
        """
        if solver.step_rate_hz % clock.state_rate_hz:
            raise ValueError(
                f"step_rate_hz={solver.step_rate_hz} is not a multiple of state_rate_hz={clock.state_rate_hz}"
            )
        bullet, client = self._bullet, self._client
        calls = self._reset(scene, solver, clock.state_rate_hz)
        self.num_simulations += 1
        ids = self._add_all(scene, solver)
        sampled = [_states(bullet, client, ids)]
        for _ in range(clock.num_states - 1):
            for _ in range(calls):
                bullet.stepSimulation(client)
            sampled.append(_states(bullet, client, ids))
        slots = [body.slot for body in scene.objects if body.slot is not None]
        states, presence = np.zeros((clock.num_states, num_slots, 13)), np.zeros(num_slots, dtype=bool)
        states[:, slots] = np.array(sampled).reshape(clock.num_states, len(slots), 13)
        presence[slots] = True
        return Trajectory(states, presence)

    def simulate_from(
        self, scene: Scene, velocity: np.ndarray, *, frames: int, solver: Solver, frame_rate_hz: int
    ) -> np.ndarray:
        """Simulate a scene from other initial velocities, for many short runs of one scene.

        Bodies are moved back, not made anew (which takes longer than a frame). What the solver remembers of the run before shifts the
        result, by about 1e-6 m.

        Args:
            scene: its own velocities do not matter.
            velocity: (object, 2) horizontal, m/s.
            frames: how many to simulate.
            solver: its settings.
            frame_rate_hz: frames per second.

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
        """Empty the world; returns how many calls of stepSimulation lead from one sample to the next.

        A call makes several steps, which spares their overhead: as many as the largest power of two that divides a sample's steps, because
        then Bullet gets the length of a step back without rounding, and the bytes are those of single steps.
        """
        bullet, client = self._bullet, self._client
        self._prepared = None
        steps = solver.step_rate_hz // sample_rate_hz
        at_once = steps & -steps
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(*scene.gravity, physicsClientId=client)
        bullet.setTimeStep(at_once / solver.step_rate_hz, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            numSubSteps=at_once,
            numSolverIterations=solver.iterations,
            useSplitImpulse=int(solver.elastic_impacts),
            splitImpulsePenetrationThreshold=0.0 if solver.elastic_impacts else BULLET_PENETRATION_THRESHOLD,
            restitutionVelocityThreshold=0.0,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        return steps // at_once

    def _add_all(self, scene: Scene, solver: Solver) -> list[int]:
        """Bullet's ids of the objects, in their order in the scene. All look like one box: else Bullet finds a hull for each round one."""
        look = self._bullet.createVisualShape(
            self._bullet.GEOM_BOX, halfExtents=[1, 1, 1], physicsClientId=self._client
        )
        added = [(body.slot, self._add(body, look, solver)) for body in scene.bodies]
        return [body_id for slot, body_id in added if slot is not None]

    def _add(self, body: Body, look: int, solver: Solver) -> int:
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
            baseVisualShapeIndex=look,
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


def _states(bullet: Any, client: int, ids: list[int]) -> list[float]:
    """13 numbers of every object in turn, as in `Trajectory.states`."""
    numbers: list[float] = []
    for body_id in ids:
        position, quaternion = bullet.getBasePositionAndOrientation(body_id, client)
        linear, angular = bullet.getBaseVelocity(body_id, client)
        numbers += (*position, *quaternion, *linear, *angular)
    return numbers


def import_pybullet() -> Any:
    """PyBullet, or an error that says where it can be had."""
    try:
        with nullcontext() if "pybullet" in sys.modules else _silent():
            import pybullet
    except ImportError as error:
        raise CophyError(
            "generating data needs PyBullet, whose wheels end at Python 3.11 on Linux x86_64: "
            "generate there (just setup), then copy data/ here; training and reports need no PyBullet"
        ) from error
    return pybullet


@contextmanager
def _silent() -> Iterator[None]:
    """Without what C code writes to standard error: PyBullet says when it was built, in every process."""
    kept = os.dup(STANDARD_ERROR)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), STANDARD_ERROR)
        yield
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(kept)


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
