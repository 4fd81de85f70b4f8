"""Base class of all scenarios: the fields of the files in conf/scenario, and the generation of twin pairs."""

import math
import re
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cophy.errors import CophyError, check_name
from cophy.scenario.assignment import PairAssignment, assign, block_of
from cophy.scenario.camera import Camera
from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.experiment import Experiment, TwinPair, with_confounders
from cophy.scenario.physics import Body, Clock, Scene, Shape, Solver, Trajectory, make_floor
from cophy.scenario.simulator import Simulator
from cophy.scenario.statics import TowerStatics

MAX_GRAVITY = 1000.0  # m/s²; ours: a hundred times that of the Earth
HEX_COLOR = re.compile("#[0-9a-fA-F]{6}")


@dataclass
class Task:
    """Evaluation of predictions on a scenario; it changes no data.

    Attributes:
        metric_dims: Number of coordinates in the MSE (balls: x and y).
        stable_speed: An object slower than this is stable, m/s.
        by_height: Whether the pixel error is also reported per object, from the lowest in C up (paper Table 1).
        splits: Names that `split=` accepts, the default first.
    """

    metric_dims: int
    stable_speed: float
    by_height: bool
    splits: list[str]

    def __post_init__(self) -> None:
        if self.metric_dims not in (1, 2, 3):
            raise ValueError(f"scenario.task.metric_dims={self.metric_dims} must be 1, 2 or 3")


@dataclass
class Scenario(ABC):
    """Fields of every scenario. Distances in m, speeds in m/s; conf/scenario explains each, with its source."""

    name: str
    colors: dict[str, str]  # name of a slot -> "#rrggbb"; a colour identifies an object
    num_objects: list[int]  # numbers of objects that an experiment may have
    confounders: ConfounderGrid
    do_operations: list[str]
    gravity_z: float
    solver: Solver
    clock: Clock
    camera: Camera
    task: Task
    min_difference: float  # outcomes differ significantly from this trajectory distance on

    def __post_init__(self) -> None:
        check_name("scenario.name", self.name)
        _check_finite("scenario", asdict(self))
        if not -MAX_GRAVITY <= self.gravity_z < 0:
            raise ValueError(f"scenario.gravity_z={self.gravity_z:g} must be negative, at least {-MAX_GRAVITY:g} m/s²")
        if self.solver.step_rate_hz % self.clock.state_rate_hz:
            raise ValueError(
                f"scenario.solver.step_rate_hz={self.solver.step_rate_hz} must be a multiple of "
                f"scenario.clock.state_rate_hz={self.clock.state_rate_hz}"
            )
        for key in self.ranges():
            values = list(getattr(self, key))
            if len(values) != 2 or values != sorted(values):
                raise ValueError(f"scenario.{key}={values} must be two numbers, the smallest and the largest")
        if min(self.num_objects, default=0) < 1:
            raise ValueError(f"scenario.num_objects={list(self.num_objects)} must be numbers from 1")
        if max(self.num_objects) > self.num_slots:
            raise ValueError(
                f"scenario.num_objects={list(self.num_objects)}: {self.name} has {self.num_slots} colours, and every object "
                "of an experiment needs its own: add '+scenario.colors.NAME=\"#rrggbb\"'"
            )
        if self.num_slots < 2:
            raise ValueError("scenario.colors must have two colours or more, since models compare pairs of slots")
        self._check_distance("min_difference", self.min_difference)
        for slot, color in self.colors.items():
            if not HEX_COLOR.fullmatch(color):
                raise ValueError(f'scenario.colors.{slot}={color} must be a colour "#rrggbb"')
        unknown = set(self.do_operations) - set(self.known_do_operations())
        if unknown or not self.do_operations:
            raise ValueError(
                f"scenario.do_operations={list(self.do_operations)} must be some of {list(self.known_do_operations())}"
            )

    def _check_distance(self, key: str, value: float) -> None:
        if self.farthest_m is not None and value > self.farthest_m:
            raise ValueError(
                f"scenario.{key}={value:g} m must be at most {self.farthest_m:.3g} m: "
                "nothing moves farther in this scenario"
            )

    @property
    def num_slots(self) -> int:
        """Number of colour slots K of every array."""
        return len(self.colors)

    @classmethod
    def search_version(cls) -> int:
        """Version of the search; increase it if an index gives another experiment with the same configuration."""
        return 1

    @classmethod
    def ranges(cls) -> tuple[str, ...]:
        """Return the names of the fields that hold a smallest and a largest number."""
        return ("displacement",)

    @classmethod
    @abstractmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        """Return the names allowed in `do_operations`."""

    @classmethod
    @abstractmethod
    def cells(cls) -> tuple[str, ...]:
        """Return the names of the cells that `Experiment.cell` indexes."""

    @classmethod
    def blocks(cls) -> tuple[tuple[int, ...], ...]:
        """Return the kinds of block (see `assign`): the cells of the first twins of its pairs. All have one length."""
        return (tuple(range(len(cls.cells()))),)

    @classmethod
    def cell_meaning(cls) -> str:
        """Return the meaning of the words in the name of a cell, in their order; empty if there is only one cell."""
        return ""

    @classmethod
    @abstractmethod
    def symmetries(cls) -> np.ndarray:
        """Return (symmetry, 2, 2) matrices on (x, y) that map experiments to equally likely ones; the first is the identity."""

    @classmethod
    def augmentations(cls) -> np.ndarray:
        """Return (augmentation, 2, 2) matrices on (x, y) that map experiments to others with the same physics."""
        return cls.symmetries()

    @property
    @abstractmethod
    def object_size_m(self) -> float:
        """Edge of every block, diameter of every ball, diameter and height of every cylinder."""

    def floor(self) -> Body:
        """Return the ground."""
        return make_floor()

    def walls(self) -> tuple[Body, ...]:
        """Return the fixed bodies other than the floor, in simulation and in images."""
        return ()

    @property
    def statics(self) -> TowerStatics | None:
        """Analytical statics of towers; None if outcomes need a simulation."""
        return None

    def shapes_of_cell(self, cell: int) -> tuple[Shape, ...] | None:
        """Return the shapes of the objects in the scenario's own order; None if they do not depend on the cell."""
        return None

    @property
    def shape_from_positions(self) -> Shape:
        """Shape to draw where only positions are known."""
        return Shape.SPHERE

    @property
    def farthest_m(self) -> float | None:
        """Upper bound of the distance between two outcomes of an object, metres; None if there is none."""
        return None

    @property
    def significant_effect_m(self) -> float | None:
        """Smallest trajectory distance between B and D that the search requires, metres; None if it requires none."""
        return None

    @abstractmethod
    def search(
        self, assignment: PairAssignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        """Find a scene, a do-operation and a second configuration that fulfil the assignment, and simulate them.

        Args:
            assignment: What the twin pair must be.
            slots: Slots of the objects, in the scenario's own order.
            rng: The only source of randomness.

        Raises:
            CophyError: Nothing fulfils the assignment; the message names the fields of the scenario to change.
        """

    def twin_pair(
        self, num_objects: int, *, data_seed: int, pair: int, simulator: Simulator, series: int = 0
    ) -> tuple[Experiment, Experiment]:
        """Generate both experiments of a twin pair, a pure function of the scenario and the arguments.

        Args:
            pair: Index of the pair in its series.
            series: Training (0), validation (1) and test (2) pairs are one series each.

        Raises:
            CophyError: The scenario has no experiments with this number of objects, or the search fails.
        """
        if num_objects not in self.num_objects:
            raise CophyError(f"num_objects={num_objects} must be one of {self.num_objects} in scenario={self.name}")
        assignment = self.assignment(num_objects, data_seed=data_seed, series=series, pair=pair)
        # with the number of objects, so that no scene of K objects is part of one of K + 1
        rng = np.random.default_rng((data_seed, num_objects, series, pair))
        slots = tuple(int(slot) for slot in rng.permutation(self.num_slots)[:num_objects])
        background_seed = int(rng.integers(2**31))
        twins = self.search(assignment, slots, rng, simulator)
        first, second = (
            Experiment(
                scene=self.with_configuration(configuration, twins.scene),
                do_operation=twins.do_operation,
                observed=observed,
                counterfactual=counterfactual,
                configuration=configuration,
                cell=cell,
                background_seed=background_seed,
            )
            for configuration, observed, counterfactual, cell in zip(
                (assignment.first, twins.second), twins.observed, twins.counterfactual, twins.cells, strict=True
            )
        )
        return first, second

    def assignment(self, num_objects: int, *, data_seed: int, pair: int, series: int = 0) -> PairAssignment:
        """Return what a twin pair must be, see `assign`."""
        return assign(
            pair,
            data_seed=data_seed,
            series=series,
            num_configurations=self.confounders.num_configurations(num_objects),
            seen=self.seen_configurations(num_objects, data_seed),
            num_do_operations=len(self.do_operations),
            blocks=self.blocks(),
        )

    def block_of(self, pair: np.ndarray, num_objects: int, data_seed: int) -> np.ndarray:
        """Return the block of each twin pair in its series: pairs of a block are assigned the same confounders."""
        num_halves = 1 if self.seen_configurations(num_objects, data_seed) is None else 2
        return block_of(pair, num_halves=num_halves, pairs_per_block=len(self.blocks()[0]))

    def seen_configurations(self, num_objects: int, data_seed: int) -> np.ndarray | None:
        """Return the half of the configurations that † splits train on; they test on the other half (paper Table 2).

        Returns:
            (configuration,) bool; None if nothing is held out.
        """
        return None

    def simulate(self, simulator: Simulator, scene: Scene) -> Trajectory:
        """Simulate a scene with this scenario's solver and clock."""
        return simulator.simulate(scene, solver=self.solver, clock=self.clock, num_slots=self.num_slots)

    def with_configuration(self, configuration: int, scene: Scene) -> Scene:
        """Return the scene with a configuration of confounders."""
        return with_confounders(scene, self.confounders.decode(configuration, len(scene.objects)))


MIRROR_Y = np.diag([1, -1])


def disc_symmetries(num_rotations: int) -> np.ndarray:
    """Return (2 · num_rotations, 2, 2) rotations by multiples of 360° / num_rotations, without and with a reflection."""
    angles = 2 * np.pi * np.arange(num_rotations) / num_rotations
    cos, sin = np.cos(angles), np.sin(angles)
    rotations = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    return np.concatenate([rotations, rotations @ MIRROR_Y])


def square_symmetries() -> np.ndarray:
    """Return the (8, 2, 2) rotations and reflections of a square."""
    return np.rint(disc_symmetries(4)).astype(int)


def _check_finite(key: str, value: Any) -> None:
    """Raise ValueError that names the first number in a tree of values that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{key}={value} must be finite")
    children = dict(enumerate(value)) if isinstance(value, list) else value if isinstance(value, dict) else {}
    for name, child in children.items():
        _check_finite(f"{key}.{name}", child)
