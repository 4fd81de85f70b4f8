"""Declarative, frozen scenes: what is simulated, before anything moves. Units: m, s, kg, rad; z up."""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

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
