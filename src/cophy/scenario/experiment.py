"""An experiment: observed sequence AB and counterfactual sequence CD under the same confounders (paper Sec. 3)."""

from dataclasses import dataclass, replace

from cophy.scenario.confounders import Confounders
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.scene import Scene, Trajectory


@dataclass(frozen=True)
class Experiment:
    """One experiment of a twin pair.

    scene: A, with its objects in the scenario's own order (towers: bottom to top).
    do_operation_name: the scenario's name for the kind of do-operation.
    configuration: index of the confounders in the scenario's grid, for that order.
    stratum: index into the scenario's `strata`.
    background_seed: looks of floor and surroundings, shared by A, B, C, D and the twin.
    pair_simulations: simulations spent on the whole twin pair.
    """

    scene: Scene
    do_operation: DoOperation
    do_operation_name: str
    observed: Trajectory
    counterfactual: Trajectory
    confounders: Confounders
    configuration: int
    stratum: int
    background_seed: int
    pair_simulations: int


def with_confounders(scene: Scene, confounders: Confounders) -> Scene:
    """The scene with its objects' mass, friction and restitution, and its horizontal gravity, replaced."""
    values = zip(scene.objects, confounders.mass, confounders.friction, confounders.restitution, strict=True)
    for body, mass, friction, restitution in values:
        scene = scene.with_object(replace(body, mass=mass, friction=friction, restitution=restitution))
    return replace(scene, gravity=(*confounders.gravity_xy, scene.gravity[2]))
