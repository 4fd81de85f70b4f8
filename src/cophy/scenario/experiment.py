"""Experiments (paper Sec. 3): sequences AB and CD under the same confounders, and the do-operation that turns A into C."""

from dataclasses import dataclass, replace

from cophy.scenario.confounders import Confounders
from cophy.scenario.physics import Scene, Trajectory, Vector


@dataclass(frozen=True)
class Displace:
    """Do-operation that displaces one object.

    Attributes:
        kind: The scenario's name for it, one of its `do_operations`.
        slot: Slot of the object.
        offset_m: Displacement, metres, world frame.
    """

    kind: str
    slot: int
    offset_m: Vector

    def apply(self, scene: Scene) -> Scene:
        """Return C, given A."""
        body = next(body for body in scene.objects if body.slot == self.slot)
        x, y, z = (p + d for p, d in zip(body.position, self.offset_m, strict=True))
        return scene.with_object(replace(body, position=(x, y, z)))


@dataclass(frozen=True)
class Remove:
    """Do-operation that removes one object.

    Attributes:
        kind: The scenario's name for it, one of its `do_operations`.
        slot: Slot of the object.
    """

    kind: str
    slot: int

    def apply(self, scene: Scene) -> Scene:
        """Return C, given A."""
        return scene.without_object(self.slot)


DoOperation = Displace | Remove


@dataclass(frozen=True)
class Experiment:
    """One experiment of a twin pair.

    Attributes:
        scene: A, with its objects in the scenario's own order (towers: bottom to top).
        do_operation: The change from A to C.
        observed: Simulated sequence AB.
        counterfactual: Simulated sequence CD.
        configuration: Index of the confounders in the scenario's grid, in the same order of objects.
        cell: Index into the scenario's `cells`.
        background_seed: Seed of the textures of floor and backdrop, shared by A, B, C, D and the twin.
    """

    scene: Scene
    do_operation: DoOperation
    observed: Trajectory
    counterfactual: Trajectory
    configuration: int
    cell: int
    background_seed: int


@dataclass(frozen=True)
class TwinPair:
    """Result of a search: the scene and do-operation that twins share, and the outcomes under each twin's confounders.

    Attributes:
        scene: A, without confounders.
        do_operation: The change from A to C.
        second: Configuration of the second twin.
        observed: AB of the first and of the second twin.
        counterfactual: CD of the first and of the second twin.
        cells: Cells of the first and of the second twin.
    """

    scene: Scene
    do_operation: DoOperation
    second: int
    observed: tuple[Trajectory, Trajectory]
    counterfactual: tuple[Trajectory, Trajectory]
    cells: tuple[int, int]


def with_confounders(scene: Scene, confounders: Confounders) -> Scene:
    """Return the scene with these masses, frictions, restitutions and horizontal gravity."""
    values = zip(scene.objects, confounders.mass, confounders.friction, confounders.restitution, strict=True)
    for body, mass, friction, restitution in values:
        scene = scene.with_object(replace(body, mass=mass, friction=friction, restitution=restitution))
    return replace(scene, gravity=(*confounders.gravity_xy, scene.gravity[2]))
