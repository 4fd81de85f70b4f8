"""BallsCF (paper Sec. 3): balls that roll on a plane inside four walls and bounce off each other."""

from dataclasses import dataclass

import numpy as np

from cophy.scenario.experiment import Displace, DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Shape, make_floor, make_walls
from cophy.scenario.scenario import square_symmetries
from cophy.scenario.search import MAX_PLACEMENTS, SimulatedSearch, placement_error


@dataclass
class Balls(SimulatedSearch):
    """Balls, with the fields of conf/scenario/balls.yaml beyond those of every scenario."""

    ball_diameter: float
    arena_half_width: float  # from the origin to each wall's inner face
    wall_height: float
    min_gap: float  # between any two balls, and to the walls, in A and C
    speed: list[float]  # of every ball at t = 0, in a random direction: smallest and largest
    displacement: list[float]  # smallest and largest, in a random direction
    max_energy_gain: float  # between two states, relative to the initial energy

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.num_objects) < 2:
            raise ValueError(f"scenario.num_objects={list(self.num_objects)}: an experiment needs at least 2 balls")
        if self._reach < 0:
            raise ValueError(
                f"scenario.arena_half_width={self.arena_half_width:g} m leaves no place for a ball of {self.ball_diameter:g} m "
                f"with scenario.min_gap={self.min_gap:g} m to the walls"
            )

    @classmethod
    def ranges(cls) -> tuple[str, ...]:
        return ("displacement", "speed")

    @classmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        return ("displace", "remove")

    @classmethod
    def cells(cls) -> tuple[str, ...]:
        return ("balls",)

    @classmethod
    def symmetries(cls) -> np.ndarray:
        return square_symmetries()

    @property
    def object_size_m(self) -> float:
        return self.ball_diameter

    def walls(self) -> tuple[Body, ...]:
        return make_walls(self.arena_half_width, self.wall_height)

    @property
    def _reach(self) -> float:
        """Largest coordinate of a centre in A and C, metres."""
        return self.arena_half_width - self.min_gap - self.ball_diameter / 2

    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        for _ in range(MAX_PLACEMENTS):
            centres = rng.uniform(-self._reach, self._reach, (len(slots), 2))
            if self._have_gaps(centres):
                break
        else:
            raise placement_error("balls", f"{len(slots)} balls do not fit with scenario.min_gap between them")
        balls = tuple(
            Body(
                Shape.SPHERE,
                (self.ball_diameter, self.ball_diameter, self.ball_diameter),
                position=(float(x), float(y), self.ball_diameter / 2),
                slot=slot,
                mass=1.0,
            )
            for slot, (x, y) in zip(slots, centres, strict=True)
        )
        scene = Scene((make_floor(), *self.walls(), *balls), gravity=(0.0, 0.0, self.gravity_z))
        return scene.with_velocities(self.sample_velocities(scene, rng))

    def sample_velocities(self, scene: Scene, rng: np.random.Generator) -> np.ndarray:
        count = len(scene.objects)
        return np.asarray(rng.uniform(self.speed[0], self.speed[1], count)[:, None] * _sample_directions(count, rng))

    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        balls = scene.objects
        if kind == "remove":
            return Remove(kind, _slot(balls[rng.integers(len(balls))]))
        centres = np.array([ball.position[:2] for ball in balls])
        for _ in range(MAX_PLACEMENTS):
            index = int(rng.integers(len(balls)))
            x, y = rng.uniform(self.displacement[0], self.displacement[1]) * _sample_directions(1, rng)[0]
            displaced = centres.copy()
            displaced[index] += (x, y)
            if self._have_gaps(displaced) and np.abs(displaced).max() <= self._reach:
                return Displace(kind, _slot(balls[index]), (float(x), float(y), 0.0))
        raise placement_error("balls", "with scenario.displacement, no ball keeps scenario.min_gap to the others")

    def _have_gaps(self, centres: np.ndarray) -> bool:
        distance = np.linalg.norm(centres[:, None] - centres, axis=-1)
        return bool((distance[np.triu_indices(len(centres), 1)] >= self.ball_diameter + self.min_gap).all())


def _sample_directions(count: int, rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0.0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _slot(body: Body) -> int:
    assert body.slot is not None
    return body.slot
