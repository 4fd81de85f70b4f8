"""Symmetries of the plane that a scenario's physics, surroundings and distributions may have.

What every scenario has: the fields of the files in conf/scenario, and how a twin pair is made.
"""

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError, check_name
from cophy.scenario.assignment import Assignment, assign
from cophy.scenario.camera import Camera
from cophy.scenario.confounders import ConfounderGrid
from cophy.scenario.experiment import Experiment, TwinPair, with_confounders
from cophy.scenario.physics import Body, Clock, Scene, Shape, Solver, Trajectory, floor
from cophy.scenario.simulator import Simulator
from cophy.scenario.statics import TowerStatics

HEX_COLOR = re.compile("#[0-9a-fA-F]{6}")


@dataclass
class Task:
    """How predictions on this scenario are judged; changes no data.

    metric_dims: coordinates that count in the MSE (balls: x and y). stable_speed: an object slower than this (m/s)
    is stable. by_height: whether the pixel error is also given per object, from the lowest in C up (paper Table 1).
    splits: the names `split=` takes, the default first.
    """

    metric_dims: int
    stable_speed: float
    by_height: bool
    splits: list[str]


@dataclass
class Scenario(ABC):
    """Fields of every scenario. Distances in m, speeds in m/s; each is explained, with its source, in the YAML."""

    name: str
    colors: dict[str, str]  # name of a slot -> "#rrggbb"; a colour is an identity
    num_objects: list[int]  # how many objects an experiment may have
    confounders: ConfounderGrid
    do_operations: list[str]
    gravity_z: float
    solver: Solver
    clock: Clock
    camera: Camera
    task: Task
    min_difference: float  # outcomes are significantly different from this trajectory distance on

    def __post_init__(self) -> None:
        check_name("scenario.name", self.name)
        if self.farthest_m is not None and self.min_difference > self.farthest_m:
            raise ValueError(
                f"scenario.min_difference={self.min_difference:g} m: in this scenario nothing moves farther than "
                f"{self.farthest_m:.3g} m"
            )
        for key in self.ranges():
            smallest_and_largest = list(getattr(self, key))
            if len(smallest_and_largest) != 2 or smallest_and_largest != sorted(smallest_and_largest):
                raise ValueError(f"scenario.{key}={smallest_and_largest}: two numbers, the smallest and the largest")
        for slot, color in self.colors.items():
            if not HEX_COLOR.fullmatch(color):
                raise ValueError(f'scenario.colors.{slot}={color}: a colour is "#rrggbb"')
        unknown = set(self.do_operations) - set(self.known_do_operations())
        if unknown or not self.do_operations:
            wrong = f"{sorted(unknown)} not among {list(self.known_do_operations())}" if unknown else "none given"
            raise ValueError(f"scenario.do_operations: {wrong}")

    @property
    def num_slots(self) -> int:
        """Colour slots K of every array."""
        return len(self.colors)

    @classmethod
    def search_version(cls) -> int:
        """Raised when other experiments are found for the same index, with the same configuration."""
        return 1

    @classmethod
    def ranges(cls) -> tuple[str, ...]:
        """Names of the fields that hold a smallest and a largest number."""
        return ("displacement",)

    @classmethod
    @abstractmethod
    def known_do_operations(cls) -> tuple[str, ...]:
        """Names allowed in `do_operations`."""

    @classmethod
    @abstractmethod
    def cells(cls) -> tuple[str, ...]:
        """Names of the cells that `Experiment.cell` counts in."""

    @classmethod
    def blocks(cls) -> tuple[tuple[int, ...], ...]:
        """The kinds of block, in turn: the cells of the first twins of its pairs (see `assign`). All are equally long."""
        return (tuple(range(len(cls.cells()))),)

    @classmethod
    def cell_meaning(cls) -> str:
        """What the words in the name of a cell are about, in their order; empty where there is only one cell."""
        return ""

    @classmethod
    @abstractmethod
    def symmetries(cls) -> np.ndarray:
        """(symmetry, 2, 2) matrices on (x, y) that turn an experiment into one as likely; the first is the identity."""

    @classmethod
    def augmentations(cls) -> np.ndarray:
        """(augmentation, 2, 2) matrices by which training experiments are turned into others of the same physics."""
        return cls.symmetries()

    @property
    @abstractmethod
    def object_size_m(self) -> float:
        """Edge of every block, diameter of every ball, diameter and height of every cylinder."""

    def floor(self) -> Body:
        """The ground."""
        return floor()

    def walls(self) -> tuple[Body, ...]:
        """Fixed bodies besides the floor, in simulation and in pictures."""
        return ()

    @property
    def statics(self) -> TowerStatics | None:
        """What decides on paper whether towers stand; None where only simulation tells outcomes."""
        return None

    def shapes_of_cell(self, cell: int) -> tuple[Shape, ...] | None:
        """The shapes of the objects in the scenario's own order, where a cell prescribes them."""
        return None

    @property
    def shape_from_positions(self) -> Shape:
        """What to draw where only positions are known, and neither shape nor rotation."""
        return Shape.SPHERE

    @property
    def farthest_m(self) -> float | None:
        """The largest distance between two outcomes of an object, metres; None where nothing is known of it."""
        return None if self.sight_extent_m is None else 2 * math.sqrt(2) * self.sight_extent_m

    @property
    def sight_extent_m(self) -> float | None:
        """How far from the origin in x and y objects stay, metres; None where nothing keeps them in sight."""
        return None

    @property
    def significant_effect_m(self) -> float | None:
        """The trajectory distance between B and D from which a do-operation matters; None where the search asks for none."""
        return None

    @abstractmethod
    def search(
        self, assignment: Assignment, slots: tuple[int, ...], rng: np.random.Generator, simulator: Simulator
    ) -> TwinPair:
        """Find a scene, a do-operation and a second configuration that fill the assignment, and simulate them.

        Args:
            assignment: what the twin pair shall be.
            slots: of the objects, in the scenario's own order.
            rng: all that is random comes from it.
            simulator: sequences are simulated with it.

        Raises:
            CophyError: nothing fills the assignment; says which fields of the scenario to change.
        """

    def twin_pair(
        self, num_objects: int, *, data_seed: int, pair: int, simulator: Simulator
    ) -> tuple[Experiment, Experiment]:
        """The twin experiments 2·pair and 2·pair + 1: a pure function of the scenario and the arguments.

        Args:
            num_objects: in A.
            data_seed: of the dataset.
            pair: index of the pair in the dataset.
            simulator: sequences are simulated with it.

        Raises:
            CophyError: the scenario has no experiments with so many objects, or none is found.
        """
        if num_objects not in self.num_objects:
            raise CophyError(f"{self.name} has {self.num_objects} objects, not {num_objects}: see num_objects=")
        assignment = self.assignment(num_objects, data_seed=data_seed, pair=pair)
        rng = np.random.default_rng((data_seed, num_objects, pair))  # no scene of K objects recurs among those of K + 1
        slots = tuple(int(slot) for slot in rng.permutation(self.num_slots)[:num_objects])
        background_seed = int(rng.integers(2**31))
        before = simulator.num_simulations
        found = self.search(assignment, slots, rng, simulator)
        spent = simulator.num_simulations - before
        first, second = (
            Experiment(
                scene=self.under(configuration, found.scene),
                do_operation=found.do_operation,
                observed=observed,
                counterfactual=counterfactual,
                confounders=self.confounders.decode(configuration, num_objects),
                configuration=configuration,
                cell=cell,
                background_seed=background_seed,
                pair_simulations=spent,
            )
            for configuration, observed, counterfactual, cell in zip(
                (assignment.first, found.second), found.observed, found.counterfactual, found.cells, strict=True
            )
        )
        return first, second

    def assignment(self, num_objects: int, *, data_seed: int, pair: int) -> Assignment:
        """What is prescribed for a twin pair, before anything is searched for.

        Args:
            num_objects: in A.
            data_seed: of the dataset.
            pair: index of the pair in the dataset.
        """
        return assign(
            pair,
            data_seed=data_seed,
            num_configurations=self.confounders.num_configurations(num_objects),
            seen=self.seen_configurations(num_objects, data_seed),
            num_do_operations=len(self.do_operations),
            blocks=self.blocks(),
        )

    def seen_configurations(self, num_objects: int, data_seed: int) -> np.ndarray | None:
        """(configuration,) bool: the half that † splits train on; the other half they only test on (paper Table 2).

        None where nothing is held out.
        """
        return None

    def simulate(self, simulator: Simulator, scene: Scene) -> Trajectory:
        """Simulate a scene with this scenario's solver and clock."""
        return simulator.simulate(scene, solver=self.solver, clock=self.clock, num_slots=self.num_slots)

    def under(self, configuration: int, scene: Scene) -> Scene:
        """The scene A under a configuration of confounders."""
        return with_confounders(scene, self.confounders.decode(configuration, len(scene.objects)))


MIRROR_Y = np.diag([1, -1])
TURNS = 64  # ours: by 5.6° each; a multiple of 4, so that the symmetries of a square are among them
QUARTER_TURN = np.array([[0, -1], [1, 0]])


def disc(turns: int) -> np.ndarray:
    """(2 · turns, 2, 2) rotations by all multiples of 360° / turns, each without and with a reflection."""
    angles = 2 * np.pi * np.arange(turns) / turns
    cos, sin = np.cos(angles), np.sin(angles)
    rotations = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    return np.concatenate([rotations, rotations @ MIRROR_Y])


def square() -> np.ndarray:
    """(8, 2, 2) the rotations and reflections of a square."""
    turns = [np.linalg.matrix_power(QUARTER_TURN, n) for n in range(4)]
    return np.stack([*turns, *(turn @ MIRROR_Y for turn in turns)])
