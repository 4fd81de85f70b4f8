"""CollisionCF (paper Sec. 3): one moving object, a sphere or a cylinder, is sent towards one static object."""

from dataclasses import dataclass

import numpy as np

from cophy.scenario.do_operations import Displace, DoOperation
from cophy.scenario.physics.scene import Body, Scene, Shape
from cophy.scenario.physics.surroundings import floor
from cophy.scenario.search.simulated import SimulatedSearch
from cophy.scenario.symmetry import mirror

# (moving, static): shapes of the two objects, one cell each
CELLS = tuple(
    (moving, static) for moving in (Shape.SPHERE, Shape.CYLINDER) for static in (Shape.SPHERE, Shape.CYLINDER)
)


@dataclass
class Collision(SimulatedSearch):
    """Fields of conf/scenario/collision.yaml beyond those of every scenario."""

    object_size: float  # diameter of spheres and cylinders, and height of cylinders
    static_position: list[float]  # x, y of the static object in A
    distance: list[float]  # between the two centres in A: smallest and largest
    max_heading: float  # of the moving object, from the x axis to either side, rad
    speed: list[float]  # of the moving object at t = 0: smallest and largest
    max_skew: float  # of a moving cylinder's axis from across its path, to either side, rad; it lies
    max_aim_offset: float  # by how far the moving object is aimed past the static one's centre
    displacement: list[float]  # along x or y: smallest and largest
    min_gap: float  # between the two objects, in A and C

    @classmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        return ("displace_moving", "displace_static")

    @classmethod
    def cells(cls) -> tuple[str, ...]:
        return tuple(f"{moving.name}_{static.name}".lower() for moving, static in CELLS)

    @classmethod
    def cell_meaning(cls) -> str:
        return "moving, static object"

    @classmethod
    def symmetries(cls) -> np.ndarray:
        return mirror()

    @property
    def object_size_m(self) -> float:
        return self.object_size

    def shapes_of_cell(self, cell: int) -> tuple[Shape, ...]:
        return CELLS[cell]

    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        moving, static = CELLS[cell]
        heading = rng.uniform(-self.max_heading, self.max_heading)
        target = np.array(self.static_position)
        forward = np.array([np.cos(heading), np.sin(heading)])
        left = np.array([-forward[1], forward[0]])
        start = target - rng.uniform(self.distance[0], self.distance[1]) * forward
        aim = target + rng.uniform(-self.max_aim_offset, self.max_aim_offset) * left
        direction = (aim - start) / np.linalg.norm(aim - start)
        velocity = rng.uniform(self.speed[0], self.speed[1]) * direction
        across = float(np.arctan2(direction[1], direction[0])) + rng.uniform(-self.max_skew, self.max_skew)
        bodies = (
            self._body(moving, slots[0], start, velocity, yaw=across, lies=True),
            self._body(static, slots[1], target, np.zeros(2), yaw=rng.uniform(0, 2 * np.pi), lies=rng.random() < 0.5),
        )
        return Scene((floor(), *bodies), gravity=(0.0, 0.0, self.gravity_z))

    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        moving, static = scene.objects
        body, other = (moving, static) if kind == "displace_moving" else (static, moving)
        assert body.slot is not None
        while True:
            offset = np.zeros(2)
            offset[rng.integers(2)] = rng.uniform(self.displacement[0], self.displacement[1]) * rng.choice([-1.0, 1.0])
            between = np.array(body.position[:2]) + offset - other.position[:2]
            # two cylinders lying end to end reach furthest: half a space diagonal each
            if np.linalg.norm(between) >= np.sqrt(2) * self.object_size + self.min_gap:
                return Displace(kind, body.slot, (float(offset[0]), float(offset[1]), 0.0))

    def _body(
        self, shape: Shape, slot: int, centre: np.ndarray, velocity: np.ndarray, *, yaw: float, lies: bool
    ) -> Body:
        """An object on the floor; a cylinder stands, or lies with its axis across the yaw (rad)."""
        tilt = np.pi / 4 if shape is Shape.CYLINDER and lies else 0.0  # half of the turn that lays the axis down
        return Body(
            shape,
            (self.object_size, self.object_size, self.object_size),
            position=(float(centre[0]), float(centre[1]), self.object_size / 2),
            quaternion_xyzw=(
                float(np.cos(yaw / 2) * np.sin(tilt)),
                float(np.sin(yaw / 2) * np.sin(tilt)),
                float(np.sin(yaw / 2) * np.cos(tilt)),
                float(np.cos(yaw / 2) * np.cos(tilt)),
            ),
            linear_velocity=(float(velocity[0]), float(velocity[1]), 0.0),
            slot=slot,
            mass=1.0,
        )
