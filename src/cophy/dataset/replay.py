"""Scenes and do-operations of stored experiments, to look at them again or to simulate them again."""

import numpy as np

from cophy.scenario import Scenario
from cophy.scenario.experiment import Displace, DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Shape, Trajectory


def scene_of(arrays: dict[str, np.ndarray], row: int, scenario: Scenario) -> Scene:
    """A of an experiment under its confounders, from its first stored state (float32).

    Args:
        arrays: of a dataset.
        row: of the experiment.
        scenario: of the dataset.
    """
    order = arrays["object_index"][row]
    slots = sorted(np.flatnonzero(order >= 0).tolist(), key=lambda slot: order[slot])
    return Scene(
        (scenario.floor(), *scenario.walls(), *(_body(arrays, row, slot, scenario.object_size_m) for slot in slots)),
        gravity=_vector(arrays["gravity"][row]),
    )


def do_operation_of(arrays: dict[str, np.ndarray], row: int, scenario: Scenario) -> DoOperation:
    """What makes C of A, in generated data.

    Args:
        arrays: of a dataset.
        row: of the experiment.
        scenario: of the dataset.
    """
    kind, slot = scenario.do_operations[arrays["do_operation"][row]], int(arrays["do_slot"][row])
    if not arrays["presence"][row, 1, slot]:
        return Remove(kind, slot)
    return Displace(kind, slot, _vector(arrays["do_offset"][row]))


def trajectories_of(arrays: dict[str, np.ndarray], row: int) -> tuple[Trajectory, Trajectory]:
    """AB and CD as they are stored."""
    first, second = (
        Trajectory(states.astype(np.float64), presence)
        for states, presence in zip(arrays["states"][row], arrays["presence"][row], strict=True)
    )
    return first, second


def _body(arrays: dict[str, np.ndarray], row: int, slot: int, size_m: float) -> Body:
    state = arrays["states"][row, 0, 0, slot].astype(np.float64)
    x, y, z, w = (state[3:7] / np.linalg.norm(state[3:7])).tolist()
    mass, friction, restitution = (float(arrays[name][row, slot]) for name in ("mass", "friction", "restitution"))
    return Body(
        Shape(int(arrays["shape"][row, slot])),
        (size_m, size_m, size_m),
        position=_vector(state[:3]),
        quaternion_xyzw=(x, y, z, w),
        linear_velocity=_vector(state[7:10]),
        slot=slot,
        mass=mass,
        friction=friction,
        restitution=restitution,
    )


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
