"""Generated experiments as arrays: the fields of a shard, and how they are filled."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from cophy.dataset.shards import Field, Fields, empty_arrays
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, split_of_experiments
from cophy.scenario import Displace, Experiment, Shape

PER_SLOT = "experiment, slot"
HIDDEN = "a confounder: no picture shows it"
EMPTY = "zero where a slot is empty"
SHAPES = ", ".join(["0: none", *(f"{shape.value}: {shape.name.lower()}" for shape in Shape)])
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
    per_slot = (count, num_slots)
    sequences = "sequence 0 is AB, which is observed, and 1 is CD, the counterfactual"
    return {
        "states": Field(
            states,
            "<f4",
            storage=storage,
            axes="experiment, sequence, time, slot, value",
            unit="m, 1, m/s, rad/s",
            meaning=f"position (3), quaternion x y z w (4), linear velocity (3), angular velocity (3); {EMPTY}; {sequences}",
        ),
        "presence": Field(
            (count, 2, num_slots),
            "|b1",
            axes="experiment, sequence, slot",
            meaning=f"whether the slot holds an object; {sequences}",
        ),
        "shape": Field(
            per_slot, "|u1", axes=PER_SLOT, meaning=f"{SHAPES}; an object that is removed in C has its shape"
        ),
        "object_index": Field(
            per_slot,
            "|i1",
            axes=PER_SLOT,
            meaning="place of the object in the scenario's own order, which `configuration` counts in (towers: from the bottom "
            "up); -1 where the slot is empty",
        ),
        "mass": Field(per_slot, "<f4", axes=PER_SLOT, unit="kg", meaning=f"mass; {HIDDEN}; {EMPTY}"),
        "friction": Field(
            per_slot, "<f4", axes=PER_SLOT, unit="1", meaning=f"coefficient of lateral friction; {HIDDEN}; {EMPTY}"
        ),
        "restitution": Field(
            per_slot, "<f4", axes=PER_SLOT, unit="1", meaning=f"coefficient of restitution; {HIDDEN}; {EMPTY}"
        ),
        "gravity": Field((count, 3), "<f4", axes="experiment, x y z", unit="m/s^2", meaning=f"gravity; {HIDDEN}"),
    }


def experiment_fields(spec: DatasetSpec, count: int) -> Fields:
    """Fields of `count` experiments, each with what it means: the same words are in the files and in the card."""
    scenario, per_experiment = spec.scenario, "experiment"
    return {
        **scene_fields(count, scenario.clock.num_states, scenario.num_slots),
        "configuration": Field(
            (count,), "<i4", axes=per_experiment, meaning="index of the confounders' values among all combinations"
        ),
        "seen": Field(
            (count,),
            "|b1",
            axes=per_experiment,
            meaning="whether the combination belongs to the half that the splits 3to3_unseen and 4to4_unseen train on",
        ),
        "do_operation": Field(
            (count,),
            "|u1",
            axes=per_experiment,
            meaning=f"what changes A into C: {_counted(scenario.do_operations)}",
        ),
        "do_slot": Field((count,), "|u1", axes=per_experiment, meaning="slot of the object that is removed or moved"),
        "do_offset": Field(
            (count, 3),
            "<f4",
            axes="experiment, x y z",
            unit="m",
            meaning="by how much it is moved; zero where it is removed",
        ),
        "cell": Field(
            (count,),
            "|u1",
            axes=per_experiment,
            meaning=f"the kind of experiment that was searched for: {_counted(scenario.cells())}",
        ),
        "twin": Field(
            (count,),
            "<i4",
            axes=per_experiment,
            meaning="number of the pair of twins; experiments 2 i and 2 i + 1 are twins",
        ),
        "split": Field((count,), "|u1", axes=per_experiment, meaning=_counted(SPLITS)),
        "background_seed": Field(
            (count,), "<i4", axes=per_experiment, meaning="what floor and backdrop of the pictures follow from"
        ),
        "pair_simulations": Field(
            (count,), "<i4", axes=per_experiment, meaning="simulations that the search for the pair took"
        ),
    }


def _counted(names: Iterable[str]) -> str:
    return ", ".join(f"{index}: {name}" for index, name in enumerate(names))


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
