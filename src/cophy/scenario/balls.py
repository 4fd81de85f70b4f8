"""BallsCF (paper Sec. 3): balls that roll on a plane inside four walls, bouncing off each other."""

from dataclasses import dataclass

import numpy as np

from cophy.scenario.experiment import Displace, DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Shape, Trajectory, floor, largest_gain, walls
from cophy.scenario.scenario import square
from cophy.scenario.search import TRIES, SimulatedSearch, no_room


@dataclass
class Balls(SimulatedSearch):
    """Fields of conf/scenario/balls.yaml beyond those of every scenario."""

    ball_diameter: float
    arena_half_width: float  # from the origin to each wall's inner face
    wall_height: float
    min_gap: float  # between any two balls, and to the walls, in A and C
    speed: list[float]  # of every ball at t = 0, in a random direction: smallest and largest
    displacement: list[float]  # smallest and largest, in a random direction
    max_energy_gain: float  # between two states, as a share of the energy at the start

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
        return square()

    @property
    def object_size_m(self) -> float:
        return self.ball_diameter

    def walls(self) -> tuple[Body, ...]:
        return walls(self.arena_half_width, self.wall_height)

    def sample_scene(self, cell: int, slots: tuple[int, ...], rng: np.random.Generator) -> Scene:
        reach = self.arena_half_width - self.min_gap - self.ball_diameter / 2
        centres = rng.uniform(-reach, reach, (len(slots), 2))
        tries = 1
        while not self._apart(centres):
            if tries == TRIES:
                raise no_room("balls", f"{len(slots)} balls do not fit with scenario.min_gap between them")
            centres, tries = rng.uniform(-reach, reach, (len(slots), 2)), tries + 1
        velocities = self.random_velocities(len(slots), rng)
        balls = tuple(
            Body(
                Shape.SPHERE,
                (self.ball_diameter, self.ball_diameter, self.ball_diameter),
                position=(float(x), float(y), self.ball_diameter / 2),
                linear_velocity=(float(vx), float(vy), 0.0),
                slot=slot,
                mass=1.0,
            )
            for slot, (x, y), (vx, vy) in zip(slots, centres, velocities, strict=True)
        )
        bodies = (floor(), *self.walls(), *balls)
        return Scene(bodies, gravity=(0.0, 0.0, self.gravity_z))

    def random_velocities(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(ball, 2) horizontal initial velocities of so many balls, m/s."""
        return np.asarray(rng.uniform(self.speed[0], self.speed[1], count)[:, None] * _directions(count, rng))

    def sample_do_operation(self, kind: str, scene: Scene, rng: np.random.Generator) -> DoOperation:
        balls = scene.objects
        if kind == "remove":
            return Remove(kind, _slot(balls[rng.integers(len(balls))]))
        centres = np.array([ball.position[:2] for ball in balls])
        reach = self.arena_half_width - self.min_gap - self.ball_diameter / 2
        for _ in range(TRIES):
            index = int(rng.integers(len(balls)))
            x, y = rng.uniform(self.displacement[0], self.displacement[1]) * _directions(1, rng)[0]
            moved = centres.copy()
            moved[index] += (x, y)
            if self._apart(moved) and np.abs(moved).max() <= reach:
                return Displace(kind, _slot(balls[index]), (float(x), float(y), 0.0))
        raise no_room("balls", "scenario.displacement leaves no ball in the arena with scenario.min_gap to the others")

    def is_admissible(self, scene: Scene, trajectory: Trajectory) -> bool:
        """Whether the sequence stays in sight and gains no energy from an impact that the solver resolves wrongly."""
        return super().is_admissible(scene, trajectory) and largest_gain(scene, trajectory) <= self.max_energy_gain

    def _apart(self, centres: np.ndarray) -> bool:
        distance = np.linalg.norm(centres[:, None] - centres, axis=-1)
        return bool((distance[np.triu_indices(len(centres), 1)] >= self.ball_diameter + self.min_gap).all())


def _directions(count: int, rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0.0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _slot(body: Body) -> int:
    assert body.slot is not None
    return body.slot
