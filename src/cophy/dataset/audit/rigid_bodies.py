"""States are those of rigid bodies in this scene: finite, apart, in sight, without energy from nowhere."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, none_wrong
from cophy.dataset.audit.first_frames import slots_in_order
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.experiment_arrays import CONFOUNDERS_OF_OBJECTS
from cophy.scenario.physics.energy import largest_gain
from cophy.scenario.search.simulated import SimulatedSearch

ROUNDING_TOLERANCE_M = 1e-5  # of float32
MAX_PENETRATION = 0.05  # penetration as a share of an object's size: what Bullet needs to turn the fastest balls around (docs/benchmark/physics.md)
MAX_ENERGY_GAIN = 0.01  # of energy between two states, as conf/scenario/balls.yaml has it


def states(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """All checks on trajectories."""
    finite = bool(np.isfinite(arrays["states"]).all())
    vacant = arrays["object_index"] < 0
    given = [
        arrays["states"].swapaxes(2, 3)[~arrays["presence"]],
        *(arrays[name][vacant] for name in CONFOUNDERS_OF_OBJECTS),
    ]
    empty = not any(values.any() for values in given)
    yield Check("states are finite, empty slots zero", "yes" if finite and empty else "no", finite and empty)
    yield _configurations(arrays, spec)
    if finite:
        yield _do_operations(arrays)
        yield from places(arrays, spec.scenario.object_size_m)
        if isinstance(spec.scenario, SimulatedSearch):
            yield _in_sight(arrays, spec.scenario)
        yield _energy(arrays, spec)


def _configurations(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Masses, frictions, restitutions and gravity are those of the configuration, in the scenario's order."""
    wrong, slots = [], slots_in_order(arrays, spec.num_objects)
    for row, configuration in enumerate(arrays["configuration"].tolist()):
        truth = spec.scenario.confounders.decode(configuration, spec.num_objects)
        stored = [arrays[name][row, slots[row]] for name in CONFOUNDERS_OF_OBJECTS]
        expected = [truth.mass, truth.friction, truth.restitution]
        gravity = (*truth.gravity_xy, spec.scenario.gravity_z)
        if not np.allclose(stored, expected) or not np.allclose(arrays["gravity"][row], gravity):
            wrong.append(row)
    return none_wrong("confounders are those of the configuration", wrong)


def _do_operations(arrays: Arrays) -> Check:
    """At t = 0, C differs from A by the do-operation and by nothing else."""
    wrong = []
    for row, (first, second) in enumerate(arrays["states"][:, :, 0, :, :7].astype(np.float64)):
        expected, presence = first.copy(), arrays["presence"][row, 0].copy()
        slot = int(arrays["do_slot"][row])
        expected[slot, :3] += arrays["do_offset"][row]
        if not arrays["presence"][row, 1, slot]:
            expected[slot], presence[slot] = 0.0, False
        same = (presence == arrays["presence"][row, 1]).all()
        if not same or np.abs(expected - second).max() > ROUNDING_TOLERANCE_M:
            wrong.append(row)
    return none_wrong("C is A under the do-operation", wrong)


def places(arrays: Arrays, size_m: float) -> Iterator[Check]:
    """Objects of one size do not overlap, and are not below the floor.

    Spheres that fit into two objects cannot overlap, whatever the objects' shapes and turns.
    """
    others, nearest, lowest = ~np.eye(arrays["presence"].shape[-1], dtype=bool), np.inf, np.inf
    for rows, present in zip(arrays["states"][..., :3], arrays["presence"], strict=True):  # pairs of all take memory
        both = present[:, :, None] & present[:, None, :] & others
        distance = np.linalg.norm(rows[:, :, :, None] - rows[:, :, None, :], axis=-1).min(axis=1)
        nearest = min(nearest, distance[both].min(initial=np.inf))
        lowest = min(lowest, rows[..., 2].swapaxes(1, 2)[present].min())
    apart, above = (1 - MAX_PENETRATION) * size_m, (0.5 - MAX_PENETRATION) * size_m
    yield Check("objects are apart, centres at least", f"{nearest:.3f} m ≥ {apart:g} m", bool(nearest >= apart))
    yield Check("objects are above the floor, centres at least", f"{lowest:.3f} m ≥ {above:g} m", bool(lowest >= above))


def _in_sight(arrays: Arrays, scenario: SimulatedSearch) -> Check:
    position = arrays["states"][..., :3]
    seen = np.broadcast_to(arrays["presence"][:, :, None], position.shape[:-1])
    furthest = scenario.distance_in_sight(position[seen]).max()
    inside = bool(furthest <= scenario.extent + ROUNDING_TOLERANCE_M)
    return Check("objects stay in sight", f"{furthest:.2f} m ≤ {scenario.extent:g} m", inside)


def _energy(arrays: Arrays, spec: DatasetSpec) -> Check:
    """No impact adds more than MAX_ENERGY_GAIN."""
    most, where = 0.0, 0
    for row in range(len(arrays["states"])):
        scene = scene_of(arrays, row, spec.scenario)
        scenes = (scene, do_operation_of(arrays, row, spec.scenario).apply(scene))
        gain = max(largest_gain(s, t) for s, t in zip(scenes, trajectories_of(arrays, row), strict=True))
        if gain > most:
            most, where = gain, row
    return Check("no sequence gains energy", f"at most {most:.2%} (experiment {where})", most <= MAX_ENERGY_GAIN)
