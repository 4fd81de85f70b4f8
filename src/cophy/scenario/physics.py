"""Scene -> Trajectory: rigid-body simulation with PyBullet on a client that is owned, never global.

PyBullet has wheels up to CPython 3.11 only; it is imported when a simulator is made, so that training and
reports run without it.
"""

from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.scene import Body, Scene, Shape, Trajectory

BULLET_PENETRATION_THRESHOLD = -0.04  # m; Bullet's defaults
BULLET_CONTACT_THRESHOLD = 1e18


@dataclass
class Solver:
    """Settings of Bullet's constraint solver; docs/physics.md shows how they were chosen.

    elastic_impacts: resolve penetration apart from velocity and let contacts act only once bodies touch. Otherwise
        impacts gain speed from the push out of penetration, and lose it to a brake within 2 cm before the touch:
        harmless to blocks that come to rest, but elastic balls gain up to 4 % or lose most of their speed.
    """

    step_rate_hz: int
    iterations: int
    elastic_impacts: bool

    def __post_init__(self) -> None:
        if self.step_rate_hz <= 0 or self.iterations <= 0:
            raise ValueError(f"solver: step_rate_hz and iterations must be positive, not {self}")


@dataclass
class Clock:
    """How long a sequence is and how often it is sampled (paper Sec. 3: 6 s, states at 20 fps, video at 5 fps)."""

    num_frames: int
    frame_rate_hz: int
    state_rate_hz: int

    def __post_init__(self) -> None:
        if self.num_frames < 2 or self.frame_rate_hz <= 0 or self.state_rate_hz % self.frame_rate_hz:
            raise ValueError(f"clock: state_rate_hz must be a multiple of frame_rate_hz, num_frames at least 2: {self}")

    @property
    def states_per_frame(self) -> int:
        """Stored states per video frame."""
        return self.state_rate_hz // self.frame_rate_hz

    @property
    def num_states(self) -> int:
        """Stored states per sequence; frame t is state t · states_per_frame."""
        return self.num_frames * self.states_per_frame


class Simulator:
    """One PyBullet DIRECT client, closed on leaving the `with` block.

    Bodies use maximal coordinates (btRigidBody): about half the cost of Bullet's multi-body on towers of three, and
    `elastic_impacts` has its effect only there.
    """

    def __init__(self) -> None:
        self.num_simulations = 0
        self._launched: Scene | None = None
        self._ids: list[int] = []
        self._bullet = import_pybullet()
        self._client = self._bullet.connect(self._bullet.DIRECT)

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bullet.disconnect(self._client)

    def simulate(self, scene: Scene, *, solver: Solver, clock: Clock, num_slots: int) -> Trajectory:
        """Simulate a scene from rest at t = 0; the same scene gives the same bytes whatever was simulated before."""
        if solver.step_rate_hz % clock.state_rate_hz:
            raise ValueError(
                f"step_rate_hz={solver.step_rate_hz} is not a multiple of state_rate_hz={clock.state_rate_hz}"
            )
        bullet, client = self._bullet, self._client
        self._reset(scene, solver)
        self.num_simulations += 1
        added = [(body.slot, self._add(body, solver)) for body in scene.bodies]
        ids = {slot: body_id for slot, body_id in added if slot is not None}
        states = np.zeros((clock.num_states, num_slots, 13))
        steps = range(solver.step_rate_hz // clock.state_rate_hz)
        for time in range(clock.num_states):
            for slot, body_id in ids.items():
                position, quaternion = bullet.getBasePositionAndOrientation(body_id, client)
                linear, angular = bullet.getBaseVelocity(body_id, client)
                states[time, slot] = (*position, *quaternion, *linear, *angular)
            if time + 1 < clock.num_states:
                for _ in steps:
                    bullet.stepSimulation(client)
        presence = np.zeros(num_slots, dtype=bool)
        presence[list(ids)] = True
        return Trajectory(states, presence)

    def launch(
        self, scene: Scene, velocity: np.ndarray, *, frames: int, solver: Solver, frame_rate_hz: int
    ) -> np.ndarray:
        """Positions and velocities (frame, object, 6) of the scene's objects, launched with (object, 2) horizontal velocities, m/s.

        For many short runs of one scene: bodies are moved back, not made anew (which takes longer than a frame). What the solver remembers
        of the run before shifts the result, by about 1e-6 m.
        """
        bullet, client = self._bullet, self._client
        if self._launched != scene:
            self._reset(scene, solver)
            self._ids = [i for body in scene.bodies for i in [self._add(body, solver)] if body.slot is not None]
            self._launched = scene
        for body_id, body, (x, y) in zip(self._ids, scene.objects, velocity.tolist(), strict=True):
            bullet.resetBasePositionAndOrientation(body_id, body.position, body.quaternion_xyzw, client)
            bullet.resetBaseVelocity(body_id, [x, y, 0.0], [0.0, 0.0, 0.0], physicsClientId=client)
        states = np.zeros((frames, len(self._ids), 6))
        for frame in range(frames):
            for _ in range(solver.step_rate_hz // frame_rate_hz):
                bullet.stepSimulation(client)
            for index, body_id in enumerate(self._ids):
                position, _ = bullet.getBasePositionAndOrientation(body_id, client)
                linear, _ = bullet.getBaseVelocity(body_id, client)
                states[frame, index] = (*position, *linear)
        return states

    def _reset(self, scene: Scene, solver: Solver) -> None:
        bullet, client = self._bullet, self._client
        self._launched = None
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(*scene.gravity, physicsClientId=client)
        bullet.setTimeStep(1.0 / solver.step_rate_hz, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            numSolverIterations=solver.iterations,
            useSplitImpulse=int(solver.elastic_impacts),
            splitImpulsePenetrationThreshold=0.0 if solver.elastic_impacts else BULLET_PENETRATION_THRESHOLD,
            restitutionVelocityThreshold=0.0,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )

    def _add(self, body: Body, solver: Solver) -> int:
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


def import_pybullet() -> Any:
    """PyBullet, or an error that says where it can be had."""
    try:
        import pybullet
    except ImportError as error:
        raise CophyError(
            "generating data needs PyBullet, whose wheels end at Python 3.11 on Linux x86_64: "
            "generate there (just setup), then copy data/ here; training and reports need no PyBullet"
        ) from error
    return pybullet
