"""CollisionCF (paper Sec. 3): one moving object, a sphere or a cylinder, slides into one static object."""

from dataclasses import dataclass, replace

import numpy as np

from cophy.scenario.experiment import Displace, DoOperation
from cophy.scenario.physics import Body, Scene, Shape, make_floor
from cophy.scenario.scenario import square_symmetries
from cophy.scenario.search import MAX_PLACEMENTS, SimulatedSearch, placement_error

# Shapes of the moving and the static object, one cell each
CELLS = tuple(
    (moving, static) for moving in (Shape.SPHERE, Shape.CYLINDER) for static in (Shape.SPHERE, Shape.CYLINDER)
)


@dataclass
class Collision(SimulatedSearch):
    """Collisions, with the fields of conf/scenario/collision.yaml beyond those of every scenario."""

    object_size: float  # diameter of spheres and cylinders, and height of cylinders
    floor_friction: float  # the friction of a contact is the product of floor and object
    static_distance: float  # in A, of the static object from the origin, on the side of the moving one
    distance: list[float]  # between the two centres in A: smallest and largest
    speed: float  # of the moving object at t = 0
    max_aim_offset: float  # largest distance at which its path in A passes the static one's centre, on either side
    displacement: list[float]  # along x or y: smallest and largest
    min_gap: float  # between the two objects, in A and C
    max_energy_gain: float  # between two states, relative to the initial energy

    def __post_init__(self) -> None:
        super().__post_init__()
        if list(self.num_objects) != [2]:
            raise ValueError(f"scenario.num_objects={list(self.num_objects)} must be [2]: one object hits the other")

    @classmethod
    def ranges(cls) -> tuple[str, ...]:
        return ("displacement", "distance")

    @classmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        return ("displace_moving", "displace_static")

    @classmethod
    def cells(cls) -> tuple[str, ...]:
        return tuple(f"{moving.name}_{static.name}".lower() for moving, static in CELLS)

    @classmethod
    def blocks(cls) -> tuple[tuple[int, ...], ...]:
        return ((0, 3, 1, 2),)  # two consecutive pairs have all shapes, of moving and of static objects

    @classmethod
    def cell_meaning(cls) -> str:
        return "moving, static object"

    @classmethod
    def symmetries(cls) -> np.ndarray:
        return square_symmetries()

    @property
    def object_size_m(self) -> float:
        return self.object_size

    def floor(self) -> Body:
        """Return the ground with the friction of this scenario."""
        return replace(make_floor(), friction=self.floor_friction)

    def shapes_of_cell(self, cell: int) -> tuple[Shape, ...]:
        return CELLS[cell]

    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        shapes, angle = CELLS[cell], rng.uniform(-np.pi, np.pi)
        forward = np.array([np.cos(angle), np.sin(angle)])
        target = -self.static_distance * forward
        start = target - rng.uniform(self.distance[0], self.distance[1]) * forward
        moving = self._body(shapes[0], slots[0], start)
        static = self._body(shapes[1], slots[1], target)
        if static.shape is Shape.CYLINDER and rng.random() < 0.5:
            static = replace(static, quaternion_xyzw=_lying_quaternion(rng.uniform(0, 2 * np.pi)))
        scene = Scene((self.floor(), moving, static), gravity=(0.0, 0.0, self.gravity_z))
        return scene.with_velocities(self.sample_velocities(scene, rng))

    def sample_velocities(self, scene: Scene, rng: np.random.Generator) -> np.ndarray:
        """Sample the velocities of the moving and the static object.

        A does not show how far off the static object's centre the moving one is aimed; AB does.
        """
        moving, static = (np.array(body.position[:2]) for body in scene.objects)
        between = static - moving
        distance = np.linalg.norm(between)
        sin = rng.uniform(-self.max_aim_offset, self.max_aim_offset) / distance
        cos, (x, y) = np.sqrt(1 - sin**2), between / distance
        return np.stack([self.speed * np.array([cos * x - sin * y, sin * x + cos * y]), np.zeros(2)])

    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        moving, static = scene.objects
        body, other = (moving, static) if kind == "displace_moving" else (static, moving)
        assert body.slot is not None
        for _ in range(MAX_PLACEMENTS):
            offset = np.zeros(2)
            offset[rng.integers(2)] = rng.uniform(self.displacement[0], self.displacement[1]) * rng.choice([-1.0, 1.0])
            between = np.array(body.position[:2]) + offset - other.position[:2]
            # a lying cylinder is a square from above, whose corners reach half a diagonal, more than any other outline
            if np.linalg.norm(between) >= (1 + np.sqrt(2)) / 2 * self.object_size + self.min_gap:
                return Displace(kind, body.slot, (float(offset[0]), float(offset[1]), 0.0))
        raise placement_error("collision", "with scenario.displacement, the objects do not keep scenario.min_gap")

    def distance_from_origin(self, position: np.ndarray) -> np.ndarray:
        """Return the distances in the plane: headings have any direction, so the visible area is round."""
        return np.asarray(np.linalg.norm(position[..., :2], axis=-1))

    def _body(self, shape: Shape, slot: int, centre: np.ndarray) -> Body:
        """Return an object that rests on the floor."""
        x, y = centre.tolist()
        size = (self.object_size, self.object_size, self.object_size)
        return Body(shape, size, position=(x, y, self.object_size / 2), slot=slot, mass=1.0)


def _lying_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a lying cylinder whose axis is perpendicular to the yaw (rad)."""
    half, tilt = yaw / 2, np.pi / 4  # half the rotation that tilts the axis to the ground
    x, y = np.cos(half) * np.sin(tilt), np.sin(half) * np.sin(tilt)
    z, w = np.sin(half) * np.cos(tilt), np.cos(half) * np.cos(tilt)
    return float(x), float(y), float(z), float(w)
