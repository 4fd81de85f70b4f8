"""Scenes, trajectories, settings of the simulation, and the mechanical energy of a trajectory.

Units: m, s, kg, rad; z up.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np


@dataclass
class Solver:
    """Settings of Bullet's constraint solver; conf/scenario gives each scenario's, with the reason.

    Attributes:
        step_rate_hz: Steps per second.
        iterations: Iterations per step.
        elastic_impacts: Whether to resolve penetration separately from velocity, and to let contacts act only once
            bodies touch. Otherwise the resolution of penetration adds speed to impacts, and contacts brake within 2 cm
            before the touch: harmless to blocks that come to rest, but elastic balls gain up to 4 % or lose most of
            their speed.
    """

    step_rate_hz: int
    iterations: int
    elastic_impacts: bool

    def __post_init__(self) -> None:
        for key in ("step_rate_hz", "iterations"):
            if getattr(self, key) < 1:
                raise ValueError(f"scenario.solver.{key}={getattr(self, key)} must be at least 1")


MAX_STATES = 10_000  # ours: eight minutes, and what fits into memory for some thousand experiments


@dataclass
class Clock:
    """Length and sampling rates of a sequence (paper Sec. 3: 6 s, states at 20 fps, video at 5 fps)."""

    num_frames: int
    frame_rate_hz: int
    state_rate_hz: int

    def __post_init__(self) -> None:
        if (
            self.num_frames < 2
            or self.frame_rate_hz <= 0
            or self.state_rate_hz < self.frame_rate_hz
            or self.state_rate_hz % self.frame_rate_hz
        ):
            raise ValueError(
                f"clock: state_rate_hz must be a multiple of frame_rate_hz, and num_frames at least 2: {self}"
            )
        if self.num_states > MAX_STATES:
            raise ValueError(f"clock: {self.num_states:,} states in a sequence are more than {MAX_STATES:,}: {self}")

    @property
    def states_per_frame(self) -> int:
        """Number of stored states per video frame."""
        return self.state_rate_hz // self.frame_rate_hz

    @property
    def num_states(self) -> int:
        """Number of stored states per sequence; frame t is state t · states_per_frame."""
        return self.num_frames * self.states_per_frame


Vector = tuple[float, float, float]


class Shape(IntEnum):
    """Geometry of a body, and its code in the dataset (0 is an empty slot)."""

    BOX = 1
    SPHERE = 2
    CYLINDER = 3


@dataclass(frozen=True)
class Body:
    """A rigid body. Bodies without a slot are fixed: floor and walls.

    Attributes:
        size_m: Full extents along the body's own axes; the axis of a cylinder is its z.
        friction: Bullet multiplies the values of the two bodies in contact.
        restitution: Likewise.
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
            raise ValueError(f"a movable body must have a slot and a mass, a fixed one neither: {self}")


@dataclass(frozen=True)
class Scene:
    """Bodies at t = 0 and gravity (m/s²)."""

    bodies: tuple[Body, ...]
    gravity: Vector

    @property
    def objects(self) -> tuple[Body, ...]:
        """The movable bodies, which fill a slot each."""
        return tuple(body for body in self.bodies if body.slot is not None)

    def with_object(self, new: Body) -> "Scene":
        """Return this scene with the object in `new.slot` replaced."""
        bodies = tuple(new if body.slot == new.slot else body for body in self.bodies)
        return replace(self, bodies=bodies)

    def without_object(self, slot: int) -> "Scene":
        """Return this scene without the object in `slot`."""
        return replace(self, bodies=tuple(body for body in self.bodies if body.slot != slot))

    def with_velocities(self, velocity: np.ndarray) -> "Scene":
        """Return this scene with (object, 2) horizontal initial velocities, m/s, in the order of `objects`."""
        scene = self
        for body, (vx, vy) in zip(self.objects, velocity.tolist(), strict=True):
            scene = scene.with_object(replace(body, linear_velocity=(vx, vy, 0.0)))
        return scene

    def at_rest(self) -> "Scene":
        """Return this scene with all initial velocities zero."""
        return self.with_velocities(np.zeros((len(self.objects), 2)))


@dataclass(frozen=True)
class Trajectory:
    """Simulated states of one sequence.

    Attributes:
        states: (time, slot, 13) float64, at the scenario's state rate from t = 0: position 3,
            quaternion_xyzw 4, linear velocity 3, angular velocity 3; empty slots are zero.
        presence: (slot,) bool, whether a slot holds an object.
    """

    states: np.ndarray
    presence: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """Positions, (time, slot, 3), metres."""
        return self.states[..., :3]


def object_distances(first: Trajectory, second: Trajectory) -> np.ndarray:
    """Return the time-averaged distance between two trajectories of each object that is in both, metres."""
    distance = np.linalg.norm(first.positions - second.positions, axis=-1).mean(axis=0)
    return distance[first.presence & second.presence]


def trajectory_distance(first: Trajectory, second: Trajectory) -> float:
    """Return the largest time-averaged distance of an object between two trajectories, metres."""
    return float(object_distances(first, second).max())


FLOOR_EXTENT_M = 100.0
WALL_THICKNESS_M = 1.0


def make_floor() -> Body:
    """Return the ground, whose top face is z = 0.

    Its friction is 1, and Bullet multiplies the values of two bodies, so an object's own friction applies. Impacts on the
    ground are inelastic.
    """
    return Body(Shape.BOX, (FLOOR_EXTENT_M, FLOOR_EXTENT_M, 1.0), position=(0.0, 0.0, -0.5), friction=1.0)


def make_walls(half_width: float, height: float) -> tuple[Body, Body, Body, Body]:
    """Return four frictionless walls with inner faces at ±half_width in x and y; an object's own restitution applies."""
    centre, length = half_width + WALL_THICKNESS_M / 2, 2 * (half_width + WALL_THICKNESS_M)

    def wall(x: float, y: float) -> Body:
        size = (WALL_THICKNESS_M, length, height) if x else (length, WALL_THICKNESS_M, height)
        return Body(Shape.BOX, size, position=(x, y, height / 2), friction=0.0, restitution=1.0)

    return wall(-centre, 0.0), wall(centre, 0.0), wall(0.0, -centre), wall(0.0, centre)


def x_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return (..., 3) unit vectors along the x axes of bodies with (..., 4) quaternions.

    `scipy.spatial.transform.Rotation` raises for zero quaternions, which empty slots have, and for NaN.
    """
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=-1)


def z_axis(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return (..., 3) unit vectors along the z axes of bodies with (..., 4) quaternions, see `x_axis`."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    return np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)


MIN_START_ENERGY_J = (
    10.0  # 1 kg at 1 m: gains of scenes with less energy, such as standing towers, are relative to this
)


def mechanical_energy(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """Return the kinetic plus potential energy of the scene's objects, (time,) J above its lowest value."""
    total = np.zeros(len(trajectory.states))
    for body in scene.objects:
        position, quaternion, linear, angular = np.split(trajectory.states[:, body.slot], [3, 7, 10], axis=-1)
        spin = (angular * z_axis(quaternion)).sum(axis=-1) ** 2
        tumble = (angular**2).sum(axis=-1) - spin
        z_moment, side_moment = _moments_per_mass(body)
        kinetic = 0.5 * ((linear**2).sum(axis=-1) + z_moment * spin + side_moment * tumble)
        total += body.mass * (kinetic - position @ np.array(scene.gravity))
    return total - total.min()


def largest_energy_gain(scene: Scene, trajectory: Trajectory) -> float:
    """Return the largest gain between two successive states relative to the initial energy; correct physics has none."""
    joules = mechanical_energy(scene, trajectory)
    return float(np.diff(joules).max() / max(joules[0], MIN_START_ENERGY_J))


def _moments_per_mass(body: Body) -> tuple[float, float]:
    """Return the moments of inertia per mass (m²) about the body's z axis and across it; boxes have square bases."""
    width, depth, height = body.size_m
    if body.shape is Shape.BOX:
        return (width**2 + depth**2) / 12, (width**2 + height**2) / 12
    if body.shape is Shape.SPHERE:
        return width**2 / 10, width**2 / 10
    return width**2 / 8, width**2 / 16 + height**2 / 12
