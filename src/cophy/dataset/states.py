"""Generated experiments: the arrays of their shards, the conversion of experiments to arrays and back, and the dataset.

The dataset (`States`) holds states, confounders, do-operation and split of every experiment; images are stored next to it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.dataset.cards import TEST_TWINS, write_card
from cophy.dataset.experiment_set import ALL_FRAMES, ExperimentSet, NeededFrames
from cophy.dataset.images import Images
from cophy.dataset.shards import MAX_FLOAT, Arrays, Field, Fields, empty_arrays, encode
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS
from cophy.scenario import Displace, Experiment, Scenario, Shape, Simulator
from cophy.scenario.confounders import CONFOUNDERS_OF_OBJECTS
from cophy.scenario.experiment import DoOperation, Remove
from cophy.scenario.physics import Body, Scene, Trajectory, x_axis, z_axis
from cophy.scenario.rendering import RenderSettings

HIDDEN = "a confounder: no picture shows it"
EMPTY = "zero where a slot is empty"
SHAPES = ", ".join(["0: none", *(f"{shape.value}: {shape.name.lower()}" for shape in Shape)])
WHICH_SEQUENCE = "sequence 0 is AB, which is observed, and 1 is CD, the counterfactual"
MAX_STATE = 1e4  # ours, in m, m/s and rad/s: hundreds of times what happens in any scenario


def scene_fields(count: int, num_times: int, num_slots: int, *, may_be_nan: bool = False) -> Fields:
    """Return the fields of `count` experiments that generated and released data share: scenes and their sequences.

    Args:
        num_times: States of a sequence; they are compressed one experiment at a time.
        may_be_nan: Whether confounders may be unknown.
    """

    def per_slot(dtype: str, meaning: str, unit: str = "", *, limits: tuple[float, float]) -> Field:
        nan = may_be_nan and dtype == "<f4"
        return Field((count, num_slots), dtype, "experiment, slot", meaning, unit, limits=limits, may_be_nan=nan)

    states = (count, 2, num_times, num_slots, 13)
    return {
        "states": Field(
            states,
            "<f4",
            "experiment, sequence, time, slot, value",
            f"position (3), quaternion x y z w (4), linear velocity (3), angular velocity (3); {EMPTY}; {WHICH_SEQUENCE}",
            "m, 1, m/s, rad/s",
            {"chunks": (1, *states[1:]), "compression": "gzip", "compression_opts": 1, "shuffle": True},
            (-MAX_STATE, MAX_STATE),
        ),
        "presence": Field(
            (count, 2, num_slots),
            "|b1",
            "experiment, sequence, slot",
            f"whether the slot holds an object; {WHICH_SEQUENCE}",
        ),
        "shape": per_slot("|u1", f"{SHAPES}; an object that is removed in C has its shape", limits=(0, max(Shape))),
        "object_index": per_slot(
            "|i1",
            "place of the object in the scenario's own order, which `configuration` counts in (towers: from the bottom up); "
            "-1 where the slot is empty",
            limits=(-1, num_slots - 1),
        ),
        "mass": per_slot("<f4", f"mass; {HIDDEN}; {EMPTY}", "kg", limits=(0, MAX_FLOAT)),
        "friction": per_slot("<f4", f"coefficient of lateral friction; {HIDDEN}; {EMPTY}", "1", limits=(0, MAX_FLOAT)),
        "restitution": per_slot("<f4", f"coefficient of restitution; {HIDDEN}; {EMPTY}", "1", limits=(0, 1)),
        "gravity": Field((count, 3), "<f4", "experiment, x y z", f"gravity; {HIDDEN}", "m/s^2", may_be_nan=may_be_nan),
    }


def experiment_fields(spec: DatasetSpec, count: int) -> Fields:
    """Return the fields of `count` generated experiments."""

    def per_experiment(dtype: str, meaning: str, values: int | None = None) -> Field:
        limits = (-MAX_FLOAT, MAX_FLOAT) if values is None else (0, values - 1)
        return Field((count,), dtype, "experiment", meaning, limits=limits)

    scenario = spec.scenario
    num_configurations = scenario.confounders.num_configurations(spec.num_objects)
    return {
        **scene_fields(count, scenario.clock.num_states, scenario.num_slots),
        "configuration": per_experiment(
            "<i4" if num_configurations <= 2**31 else "<i8",
            "index of the confounders' values among all combinations",
            num_configurations,
        ),
        "seen": per_experiment(
            "|b1", "whether the combination belongs to the half that the splits 3to3_unseen and 4to4_unseen train on"
        ),
        "do_operation": per_experiment(
            "|u1", f"what changes A into C: {_numbered(scenario.do_operations)}", len(scenario.do_operations)
        ),
        "do_slot": per_experiment("|u1", "slot of the object that is removed or moved", scenario.num_slots),
        "do_offset": Field(
            (count, 3), "<f4", "experiment, x y z", "by how much it is moved; zero where it is removed", "m"
        ),
        "cell": per_experiment(
            "|u1", f"the kind of experiment that was searched for: {_numbered(scenario.cells())}", len(scenario.cells())
        ),
        "twin": per_experiment("<i4", "number of the pair of twins, equal for both; -1 in the test split"),
        "split": per_experiment("|u1", _numbered(SPLITS), len(SPLITS)),
        "background_seed": per_experiment("<i4", "what floor and backdrop of the pictures follow from"),
    }


def _numbered(names: Iterable[str]) -> str:
    return ", ".join(f"{index}: {name}" for index, name in enumerate(names))


def to_arrays(experiments: Sequence[Experiment], indices: Sequence[int], spec: DatasetSpec) -> Arrays:
    """Stack experiments.

    Args:
        indices: Their indices in the dataset.
    """
    arrays, order = empty_arrays(experiment_fields(spec, len(indices))), spec.order
    arrays["object_index"][:] = -1
    arrays["split"][:] = order.split[list(indices)]
    arrays["twin"][:] = np.where(arrays["split"] == SPLITS.index("test"), -1, order.pair[list(indices)])
    seen = spec.scenario.seen_configurations(spec.num_objects, spec.data_seed)
    for row, experiment in enumerate(experiments):
        operation, sequences = experiment.do_operation, (experiment.observed, experiment.counterfactual)
        values = {
            "states": np.stack([sequence.states for sequence in sequences]),
            "presence": np.stack([sequence.presence for sequence in sequences]),
            "gravity": experiment.scene.gravity,
            "configuration": experiment.configuration,
            "seen": seen is None or seen[experiment.configuration],
            "do_operation": spec.scenario.do_operations.index(operation.kind),
            "do_slot": operation.slot,
            "do_offset": operation.offset_m if isinstance(operation, Displace) else 0.0,
            "cell": experiment.cell,
            "background_seed": experiment.background_seed,
        }
        for name, value in values.items():
            arrays[name][row] = value
        for index, body in enumerate(experiment.scene.objects):
            arrays["object_index"][row, body.slot] = index
            arrays["shape"][row, body.slot] = body.shape
            for name in CONFOUNDERS_OF_OBJECTS:
                arrays[name][row, body.slot] = getattr(body, name)
    return arrays


def make_twins(spec: DatasetSpec, pair: int, simulator: Simulator) -> tuple[Experiment, Experiment]:
    """Generate both experiments of a twin pair, given its number in the dataset (`StoredOrder.pair`)."""
    order = spec.order
    index = int(np.flatnonzero(order.pair == pair)[0])
    series, number = int(order.split[index]), int(order.number[index])
    return spec.scenario.twin_pair(
        spec.num_objects, data_seed=spec.data_seed, series=series, pair=number, simulator=simulator
    )


def sort_by_twins(arrays: Arrays, spec: DatasetSpec) -> Arrays:
    """Return all experiments of a dataset with twins next to each other, the first one first, for checks of the data.

    Returns:
        The same arrays, but `twin` is also known for test experiments; `experiment` is the index in the dataset.
    """
    rows = np.lexsort((spec.order.second, spec.order.pair))
    return {name: array[rows] for name, array in arrays.items()} | {"twin": spec.order.pair[rows], "experiment": rows}


def slots_in_order(arrays: Arrays, num_objects: int) -> np.ndarray:
    """Return the slot of each object of A, (experiment, object), in the scenario's order."""
    index = np.where(arrays["object_index"] < 0, num_objects, arrays["object_index"])
    return np.argsort(index, axis=1, kind="stable")[:, :num_objects]


def clusters_of(spec: DatasetSpec, rows: np.ndarray) -> np.ndarray:
    """Return clusters of experiments, see `ExperimentSet.clusters`: blocks of `assign`."""
    block = spec.scenario.block_of(spec.order.number[rows], spec.num_objects, spec.data_seed)
    return np.asarray(block * len(SPLITS) + spec.order.split[rows])


def build_scene(arrays: Arrays, row: int, scenario: Scenario) -> Scene:
    """Return A of an experiment under its confounders, from its first stored state (float32)."""
    order = arrays["object_index"][row]
    slots = sorted(np.flatnonzero(order >= 0).tolist(), key=lambda slot: order[slot])
    bodies = (_body(arrays, row, slot, scenario.object_size_m) for slot in slots)
    return Scene((scenario.floor(), *scenario.walls(), *bodies), gravity=_vector(arrays["gravity"][row]))


def do_operation_of(arrays: Arrays, row: int, scenario: Scenario) -> DoOperation:
    """Return the do-operation that changes A into C, for generated data."""
    kind, slot = scenario.do_operations[arrays["do_operation"][row]], int(arrays["do_slot"][row])
    if not arrays["presence"][row, 1, slot]:
        return Remove(kind, slot)
    return Displace(kind, slot, _vector(arrays["do_offset"][row]))


def trajectories_of(arrays: Arrays, row: int) -> tuple[Trajectory, Trajectory]:
    """Return AB and CD as they are stored."""
    observed, counterfactual = (
        Trajectory(states.astype(np.float64), presence)
        for states, presence in zip(arrays["states"][row], arrays["presence"][row], strict=True)
    )
    return observed, counterfactual


def _body(arrays: Arrays, row: int, slot: int, size_m: float) -> Body:
    state = arrays["states"][row, 0, 0, slot].astype(np.float64)
    x, y, z, w = (state[3:7] / np.linalg.norm(state[3:7])).tolist()
    mass, friction, restitution = (float(arrays[name][row, slot]) for name in CONFOUNDERS_OF_OBJECTS)
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


def visible_axis(quaternion_xyzw: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return the direction of a cylinder's axis (with the sign that makes x ≥ 0) or of a block's own x axis.

    quaternion_xyzw: (experiment, slot, 4). shape: (experiment, slot), codes of `Shape`. Zero for spheres and empty slots.
    """
    along_x, along_z, kind = x_axis(quaternion_xyzw), z_axis(quaternion_xyzw), shape[..., None]
    unsigned = np.where(along_z[..., :1] < 0, -along_z, along_z)
    return np.where(kind == Shape.CYLINDER, unsigned, np.where(kind == Shape.BOX, along_x, 0.0))


def stable_frames(states: np.ndarray, stride: int, stable_speed: float) -> np.ndarray:
    """Return which objects are stable in which frames.

    Args:
        states: (experiment, state, slot, 13) position, quaternion xyzw, linear and angular velocity.
        stride: states per frame.
        stable_speed: an object slower than this is stable, m/s.

    Returns:
        (experiment, frame 1 ... T-1, slot) bool: slow at every state after the frame before, up to and with this frame.
    """
    slow = np.linalg.norm(states[..., 7:10], axis=-1) < stable_speed
    num_frames = slow.shape[1] // stride
    after_first = slow[:, 1 : (num_frames - 1) * stride + 1]
    return np.asarray(after_first.reshape(len(slow), num_frames - 1, stride, -1).all(axis=2))


def reduce_to_frames(arrays: Arrays, scenario: Scenario) -> Arrays:
    """Return the arrays with one state per frame, so that the other states need no memory.

    Returns:
        The same arrays, but `states` is (experiment, 2, T, slot, 13), and `stable` (experiment, 2, T-1, slot) says whether
        an object is slow in all states from one frame to the next.
    """
    stride, states = scenario.clock.states_per_frame, arrays["states"]
    stable = [stable_frames(states[:, sequence], stride, scenario.task.stable_speed) for sequence in (0, 1)]
    present = arrays["presence"][:, :, None]
    return arrays | {"states": states[:, :, ::stride].copy(), "stable": np.stack(stable, axis=1) & present}


COST = {  # CPU-seconds and kB per experiment: measured for towers of 3, balls of 4 and collisions, else estimated
    ("blocktower", 3): (0.22, 23), ("blocktower", 4): (0.45, 33), ("balls", 2): (0.6, 20), ("balls", 3): (0.15, 24),
    ("balls", 4): (0.14, 29), ("balls", 5): (0.15, 34), ("balls", 6): (0.2, 40), ("collision", 2): (0.04, 10),
}  # fmt: skip


class States(ExperimentSet):
    """A generated dataset, in its own directory."""

    spec: DatasetSpec
    slow_hint = "; there may be no experiment that fits changed settings (min_difference, min_effect, ranges, sizes)"

    def __init__(self, spec: DatasetSpec, data_dir: Path) -> None:
        directory = spec.directory(data_dir)
        title = f"{spec.scenario.name}, {spec.num_objects} objects"
        super().__init__(spec, directory, title=title, script="generate", keys=spec.command_line_keys(directory))
        self.place = PurePosixPath(spec.scenario.name, spec.id)

    @property
    def id(self) -> str:
        return self.spec.id

    @property
    def remedy(self) -> str:
        return "use a larger size="

    def frames(self, render: RenderSettings, needed: NeededFrames = ALL_FRAMES) -> Images:
        return Images(self, render, needed)

    def pairs(self, rows: np.ndarray) -> np.ndarray:
        return self.spec.order.pair[rows]

    def clusters(self, rows: np.ndarray) -> np.ndarray:
        return clusters_of(self.spec, rows)

    def has_same_splits(self, *, data_seed: int, trained_on: Sequence[str]) -> bool:
        return data_seed == self.spec.data_seed  # splits of different sizes are parts of each other

    def cost(self, experiments: int) -> tuple[float, float]:
        seconds, kilobytes = COST.get((self.spec.scenario.name, self.spec.num_objects), (0, 0))
        return experiments * seconds, experiments * kilobytes / 1000

    def fields(self, shard: int) -> Fields:
        return experiment_fields(self.spec, len(self.spec.experiments_of_shard(shard)))

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Search and simulate the experiments of a shard."""
        spec, indices = self.spec, self.spec.experiments_of_shard(shard)
        twins: dict[int, tuple[Experiment, Experiment]] = {}
        with Simulator() as simulator:
            for pair in np.unique(spec.order.pair[list(indices)]).tolist():
                twins[pair] = make_twins(spec, pair, simulator)
                advance(2)
        experiments = [twins[spec.order.pair[index]][int(spec.order.second[index])] for index in indices]
        path.write_bytes(encode(to_arrays(experiments, indices, spec), self.fields(shard), self.attributes(shard)))
        return {"simulations": simulator.num_simulations}

    def write_manifest(self, versions: Mapping[str, str] | None = None) -> None:
        tested = np.flatnonzero(self.spec.order.split == SPLITS.index("test"))
        columns = np.stack([tested, self.pairs(tested), self.clusters(tested)], axis=1).tolist()
        lines = ["experiment,twin,cluster", *(",".join(map(str, row)) for row in columns)]
        write_atomically(self.directory / TEST_TWINS, ("\n".join(lines) + "\n").encode())
        super().write_manifest(versions)  # last: it says that the dataset is finished
        self.write_card(f"not run yet, `{self.command_for('audit')}`")

    def write_card(self, audit: str) -> None:
        """Write README.md; `audit` is a sentence about the result of an audit."""
        write_card(self.spec, self.directory, fields=self.fields(0), audit=audit)

    def description(self) -> dict[str, Any]:
        """Return the configuration and the names of the cells."""
        return {
            "id": self.spec.id,
            "configuration": self.spec.generating_configuration(),
            "cells": list(self.spec.scenario.cells()),
        }
