"""Mechanical energy of a trajectory, against which simulations are judged.

How a scene is simulated: the solver's settings, how long a sequence is and how often it is sampled.
Declarative, frozen scenes: what is simulated, before anything moves. Units: m, s, kg, rad; z up.
Fixed bodies around the objects. Their friction and restitution are 1, or 0 where contact shall have none of it:
Bullet multiplies the values of two bodies, so an object's own values hold on the floor.
Where a body's own axes point.

Written out, because `scipy.spatial.transform.Rotation` raises for quaternions that are zero or NaN. Empty slots have
such, and so has damaged data, which an audit has to look at.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

MOST = 10_000  # steps per second, and iterations per step: far more than helps


@dataclass
class Solver:
    """Settings of Bullet's constraint solver; docs/benchmark/physics.md shows how they were chosen.

    elastic_impacts: resolve penetration apart from velocity and let contacts act only once bodies touch. Otherwise
        impacts gain speed from the push out of penetration, and lose it to a brake within 2 cm before the touch:
        harmless to blocks that come to rest, but elastic balls gain up to 4 % or lose most of their speed.
    """

    step_rate_hz: int
    iterations: int
    elastic_impacts: bool

    def __post_init__(self) -> None:
        for key in ("step_rate_hz", "iterations"):
            if not 0 < getattr(self, key) <= MOST:
                raise ValueError(f"scenario.solver.{key}={getattr(self, key)} must be from 1 to {MOST}")


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


Vector = tuple[float, float, float]


class Shape(IntEnum):
    """Geometry of a body, and its code in the dataset (0 is an empty slot)."""

    BOX = 1
    SPHERE = 2
    CYLINDER = 3


@dataclass(frozen=True)
class Body:
    """A rigid body. Bodies without a slot are fixed surroundings: floor, walls.

    size_m: full extents along the body's own axes; a cylinder's axis is its z.
    friction, restitution: Bullet multiplies those of the two bodies in contact.
    """

    shape: Shape
    size_m: Vector
    position: Vector
    slot: int | None = None
    mass: float = 0.0
    friction: float = 1.0
    restitution: float = 0.0
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    linear_velocity: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if (self.slot is None) != (self.mass == 0.0):
            raise ValueError(f"a movable body has a slot and a mass, a fixed one neither: {self}")


@dataclass(frozen=True)
class Scene:
    """Bodies at t = 0 and the gravity (m/s²) they move under."""

    bodies: tuple[Body, ...]
    gravity: Vector

    @property
    def objects(self) -> tuple[Body, ...]:
        """The movable bodies, those that fill a slot."""
        return tuple(body for body in self.bodies if body.slot is not None)

    def with_object(self, changed: Body) -> "Scene":
        """This scene with the object in `changed.slot` replaced."""
        bodies = tuple(changed if body.slot == changed.slot else body for body in self.bodies)
        return replace(self, bodies=bodies)

    def without_object(self, slot: int) -> "Scene":
        """This scene with the object in `slot` gone."""
        return replace(self, bodies=tuple(body for body in self.bodies if body.slot != slot))

    def with_velocities(self, velocity: np.ndarray) -> "Scene":
        """This scene with its objects' initial velocities: (object, 2) horizontal, m/s, in the order of `objects`."""
        scene = self
        for body, (vx, vy) in zip(self.objects, velocity.tolist(), strict=True):
            scene = scene.with_object(replace(body, linear_velocity=(vx, vy, 0.0)))
        return scene

    def at_rest(self) -> "Scene":
        """This scene without initial velocities."""
        return self.with_velocities(np.zeros((len(self.objects), 2)))


@dataclass(frozen=True)
class Trajectory:
    """Simulated states of one sequence.

    Attributes:
        states: (time, slot, 13) float64, at the scenario's state rate from t = 0: position 3,
            quaternion_xyzw 4, linear velocity 3, angular velocity 3; empty slots are zero.
        presence: (slot,) bool, which slots hold an object.
    """

    states: np.ndarray
    presence: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """(time, slot, 3), metres."""
        return self.states[..., :3]


def trajectory_distance(first: Trajectory, second: Trajectory) -> float:
    """Time-averaged distance in metres of the object on which two trajectories differ most."""
    distance = np.linalg.norm(first.positions - second.positions, axis=-1).mean(axis=0)
    return float(distance[first.presence & second.presence].max())


FLOOR_EXTENT_M = 100.0
WALL_THICKNESS_M = 1.0


def floor() -> Body:
    """The ground: its top face is z = 0; impacts on it are inelastic."""
    return Body(Shape.BOX, (FLOOR_EXTENT_M, FLOOR_EXTENT_M, 1.0), position=(0.0, 0.0, -0.5), friction=1.0)


def walls(half_width: float, height: float) -> tuple[Body, Body, Body, Body]:
    """Four frictionless walls whose inner faces are at ±half_width in x and y; objects bounce at their own restitution."""
    centre, length = half_width + WALL_THICKNESS_M / 2, 2 * (half_width + WALL_THICKNESS_M)

    def wall(x: float, y: float) -> Body:
        size = (WALL_THICKNESS_M, length, height) if x else (length, WALL_THICKNESS_M, height)
        return Body(Shape.BOX, size, position=(x, y, height / 2), friction=0.0, restitution=1.0)

    return wall(-centre, 0.0), wall(centre, 0.0), wall(0.0, -centre), wall(0.0, centre)


def x_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """(..., 4) quaternions -> (..., 3) unit vectors along the bodies' own x axes."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=-1)


def z_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """(..., 4) quaternions -> (..., 3) unit vectors along the bodies' own z axes."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)


MIN_START_ENERGY_J = 10.0  # gains of what starts with less, a standing tower for one, are shares of this: 1 kg at 1 m


def energy(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(time,) kinetic and potential energy in J of the scene's objects, above its lowest value."""
    total = np.zeros(len(trajectory.states))
    for body in scene.objects:
        position, quaternion, linear, angular = np.split(trajectory.states[:, body.slot], [3, 7, 10], axis=-1)
        along = (angular * z_axis(quaternion)).sum(axis=-1) ** 2
        across = (angular**2).sum(axis=-1) - along
        about, through = _moments_per_mass(body)
        kinetic = 0.5 * ((linear**2).sum(axis=-1) + about * along + through * across)
        total += body.mass * (kinetic - position @ np.array(scene.gravity))
    return total - total.min()


def largest_gain(scene: Scene, trajectory: Trajectory) -> float:
    """The largest gain from one state to the next, as a share of the energy at the start. Nothing should gain any."""
    joules = energy(scene, trajectory)
    return float(np.diff(joules).max() / max(joules[0], MIN_START_ENERGY_J))


def _moments_per_mass(body: Body) -> tuple[float, float]:
    """Moments of inertia over mass (m²), about the body's z axis and across it; boxes are as wide as deep."""
    width, depth, height = body.size_m
    if body.shape is Shape.BOX:
        return (width**2 + depth**2) / 12, (width**2 + height**2) / 12
    if body.shape is Shape.SPHERE:
        return width**2 / 10, width**2 / 10
    return width**2 / 8, width**2 / 16 + height**2 / 12
