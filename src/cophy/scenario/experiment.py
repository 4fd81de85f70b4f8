"""Do-operations (paper Sec. 3): visible changes of the initial scene A that make it C. A itself stays as it is.

An experiment: observed sequence AB and counterfactual sequence CD under the same confounders (paper Sec. 3).
"""

from dataclasses import dataclass, replace

from cophy.scenario.confounders import Confounders
from cophy.scenario.physics import Scene, Trajectory, Vector


@dataclass(frozen=True)
class Displace:
    """Move one object.

    kind: the scenario's name for it, one of its `do_operations`. slot: of the object. offset_m: metres, world frame.
    """

    kind: str
    slot: int
    offset_m: Vector

    def apply(self, scene: Scene) -> Scene:
        """The scene with the object moved."""
        body = next(body for body in scene.objects if body.slot == self.slot)
        x, y, z = (p + d for p, d in zip(body.position, self.offset_m, strict=True))
        return scene.with_object(replace(body, position=(x, y, z)))


@dataclass(frozen=True)
class Remove:
    """Take one object away. kind: the scenario's name for it, one of its `do_operations`. slot: of the object."""

    kind: str
    slot: int

    def apply(self, scene: Scene) -> Scene:
        """The scene without the object."""
        return scene.without_object(self.slot)


DoOperation = Displace | Remove


@dataclass(frozen=True)
class Experiment:
    """One experiment of a twin pair.

    scene: A, with its objects in the scenario's own order (towers: bottom to top).
    do_operation: what makes C of A.
    observed, counterfactual: the simulated sequences AB and CD.
    confounders, configuration: their values, and their index in the scenario's grid, for that order of objects.
    cell: index into the scenario's `cells`.
    background_seed: decides the textures of floor and surroundings, shared by A, B, C, D and the twin.
    pair_simulations: simulations spent on the whole twin pair.
    """

    scene: Scene
    do_operation: DoOperation
    observed: Trajectory
    counterfactual: Trajectory
    confounders: Confounders
    configuration: int
    cell: int
    background_seed: int
    pair_simulations: int


@dataclass(frozen=True)
class TwinPair:
    """What a search found: a scene and a do-operation that twins share, and what becomes of them under either's confounders.

    second: configuration of the second twin. observed, counterfactual, cells: of the first and of the second twin.
    """

    scene: Scene
    do_operation: DoOperation
    second: int
    observed: tuple[Trajectory, Trajectory]
    counterfactual: tuple[Trajectory, Trajectory]
    cells: tuple[int, int]


def with_confounders(scene: Scene, confounders: Confounders) -> Scene:
    """The scene with its objects' mass, friction and restitution, and its horizontal gravity, replaced."""
    values = zip(scene.objects, confounders.mass, confounders.friction, confounders.restitution, strict=True)
    for body, mass, friction, restitution in values:
        scene = scene.with_object(replace(body, mass=mass, friction=friction, restitution=restitution))
    return replace(scene, gravity=(*confounders.gravity_xy, scene.gravity[2]))
