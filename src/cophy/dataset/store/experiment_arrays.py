"""Generated experiments as arrays: the fields of a shard, and how they are filled."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import split_of_experiments
from cophy.dataset.store.hdf5_arrays import Field, Fields, empty_arrays
from cophy.scenario import Displace, Experiment

CONFOUNDERS_OF_OBJECTS = ("mass", "friction", "restitution")


def scene_fields(count: int, num_times: int, num_slots: int) -> Fields:
    """Fields of scenes and their sequences, which generated and released experiments have alike.

    Args:
        count: experiments.
        num_times: states of a sequence; they are compressed one experiment at a time.
        num_slots: of the scenario.
    """
    states = (count, 2, num_times, num_slots, 13)
    storage = {"chunks": (1, *states[1:]), "compression": "gzip", "compression_opts": 1, "shuffle": True}
    return {
        "states": Field(states, "<f4", storage=storage),
        "presence": Field((count, 2, num_slots), "|b1"),
        "shape": Field((count, num_slots), "|u1"),
        "object_index": Field((count, num_slots), "|i1"),
        **{name: Field((count, num_slots), "<f4") for name in CONFOUNDERS_OF_OBJECTS},
        "gravity": Field((count, 3), "<f4"),
    }


def experiment_fields(spec: DatasetSpec, count: int) -> Fields:
    """Fields of `count` experiments. Sequence 0 is observed (AB), 1 counterfactual (CD).

    states: position, quaternion_xyzw, linear and angular velocity at the state rate. object_index: place in the
    scenario's own order (towers: bottom to top), which `configuration` refers to; -1 where the slot is empty.
    do_operation: index into the scenario's do_operations, with the slot and offset (m) it concerns.
    cell: index into the scenario's cells.
    """
    return {
        **scene_fields(count, spec.scenario.clock.num_states, spec.scenario.num_slots),
        "configuration": Field((count,), "<i4"),
        "seen": Field((count,), "|b1"),
        "do_operation": Field((count,), "|u1"),
        "do_slot": Field((count,), "|u1"),
        "do_offset": Field((count, 3), "<f4"),
        "cell": Field((count,), "|u1"),
        "twin": Field((count,), "<i4"),
        "split": Field((count,), "|u1"),
        "background_seed": Field((count,), "<i4"),
        "pair_simulations": Field((count,), "<i4"),
    }


def to_arrays(experiments: Sequence[Experiment], indices: Sequence[int], spec: DatasetSpec) -> dict[str, np.ndarray]:
    """Stack experiments.

    Args:
        experiments: both twins of each pair, in order.
        indices: which experiments of the dataset they are.
        spec: of the dataset.
    """
    arrays = empty_arrays(experiment_fields(spec, len(indices)))
    arrays["object_index"][:] = -1
    arrays["twin"][:] = np.array(indices) // 2
    arrays["split"][:] = split_of_experiments(spec.num_experiments, spec.data_seed)[list(indices)]
    seen = spec.scenario.seen_configurations(spec.num_objects, spec.data_seed)
    for row, experiment in enumerate(experiments):
        for name, value in _of_experiment(experiment, spec).items():
            arrays[name][row] = value
        arrays["seen"][row] = seen is None or seen[experiment.configuration]
        for index, body in enumerate(experiment.scene.objects):
            arrays["object_index"][row, body.slot] = index
            arrays["shape"][row, body.slot] = body.shape
            for name in CONFOUNDERS_OF_OBJECTS:
                arrays[name][row, body.slot] = getattr(body, name)
    return arrays


def _of_experiment(experiment: Experiment, spec: DatasetSpec) -> dict[str, Any]:
    operation = experiment.do_operation
    sequences = (experiment.observed, experiment.counterfactual)
    return {
        "states": np.stack([sequence.states for sequence in sequences]),
        "presence": np.stack([sequence.presence for sequence in sequences]),
        "gravity": experiment.scene.gravity,
        "configuration": experiment.configuration,
        "do_operation": spec.scenario.do_operations.index(experiment.do_operation.kind),
        "do_slot": operation.slot,
        "do_offset": operation.offset_m if isinstance(operation, Displace) else 0.0,
        "cell": experiment.cell,
        "background_seed": experiment.background_seed,
        "pair_simulations": experiment.pair_simulations,
    }
