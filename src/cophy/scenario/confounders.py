"""Confounders (paper Sec. 3): the quantities that no single image shows, and the grids of their values."""

import itertools
from dataclasses import dataclass

import numpy as np

CONFOUNDERS_OF_OBJECTS = ("mass", "friction", "restitution")  # with a value per object; gravity has one per experiment
MAX_MASS = 1e6  # kg; ours: Bullet's solver fails long before 1e30


@dataclass(frozen=True)
class Confounders:
    """True confounders of one experiment, with objects in the scenario's own order (towers: bottom to top).

    Attributes:
        mass: One value per object, kg.
        friction: One value per object.
        restitution: One value per object.
        gravity_xy: Horizontal gravity of the scene, m/s².
    """

    mass: tuple[float, ...]
    friction: tuple[float, ...]
    restitution: tuple[float, ...]
    gravity_xy: tuple[float, float]


@dataclass
class ConfounderGrid:
    """The values of each confounder; a single value makes it a constant.

    A configuration (an index in [0, num_configurations)) selects one value per object for mass, friction and
    restitution, and one per scene for the horizontal components of gravity.
    """

    mass: list[float]
    friction: list[float]
    restitution: list[float]
    gravity_x: list[float]
    gravity_y: list[float]

    def __post_init__(self) -> None:
        if not all(self._axes(1)):
            raise ValueError("confounders: every confounder needs at least one value")
        if (
            not 0 < min(self.mass) <= max(self.mass) <= MAX_MASS
            or not min(self.friction) >= 0
            or not 0 <= min(self.restitution) <= max(self.restitution) <= 1
        ):
            raise ValueError(
                f"confounders: mass must be > 0 and at most {MAX_MASS:g} kg, friction >= 0 and restitution in [0, 1]"
            )

    def _axes(self, num_objects: int) -> list[list[float]]:
        per_object = [values for values in (self.mass, self.friction, self.restitution) for _ in range(num_objects)]
        return [*per_object, self.gravity_x, self.gravity_y]

    def num_configurations(self, num_objects: int) -> int:
        """Return the number of configurations of this many objects."""
        return int(np.prod([len(axis) for axis in self._axes(num_objects)]))

    def decode(self, configuration: int, num_objects: int) -> Confounders:
        """Return the values of a configuration."""
        axes = self._axes(num_objects)
        indices = np.unravel_index(configuration, [len(axis) for axis in axes])
        values = [float(axis[index]) for axis, index in zip(axes, indices, strict=True)]
        mass, friction, restitution = (tuple(values[k * num_objects : (k + 1) * num_objects]) for k in range(3))
        return Confounders(mass, friction, restitution, gravity_xy=(values[-2], values[-1]))

    def neighbours(self, configuration: int, num_objects: int) -> list[int]:
        """Return the configurations that differ from this one in a single value."""
        shape = [len(axis) for axis in self._axes(num_objects)]
        indices = np.array(np.unravel_index(configuration, shape))
        configurations = []
        for axis, size in enumerate(shape):
            for value in range(size):
                if value != indices[axis]:
                    changed = indices.copy()
                    changed[axis] = value
                    configurations.append(int(np.ravel_multi_index(tuple(changed), shape)))
        return configurations

    def expand(self, probability: np.ndarray, num_objects: int) -> np.ndarray:
        """Expand (combination,) probabilities of masses and gravities to (configuration,), uniform in all others."""
        masses, gravities = len(self.mass) ** num_objects, len(self.gravity_x) * len(self.gravity_y)
        others = (len(self.friction) * len(self.restitution)) ** num_objects
        table = np.broadcast_to(probability.reshape(masses, 1, gravities), (masses, others, gravities))
        return table.reshape(-1) / others

    def masses_and_gravities(self, num_objects: int) -> tuple[np.ndarray, np.ndarray]:
        """Return all combinations of masses and horizontal gravity: (combination, object) kg, (combination, 2) m/s²."""
        combinations = list(itertools.product(*[self.mass] * num_objects, self.gravity_x, self.gravity_y))
        table = np.array(combinations, dtype=float)
        return table[:, :num_objects], table[:, num_objects:]
