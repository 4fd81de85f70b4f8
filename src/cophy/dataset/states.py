"""The simulated part of a dataset: states, confounders, do-operation and split of every experiment."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cophy.dataset.card import write_card
from cophy.dataset.shardset import DamagedShardError, ShardSet, dataset_in
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, split_of_experiments
from cophy.scenario import Displace, Experiment, Shape, Simulator
from cophy.scenario.assignment import seen_configurations


class States(ShardSet):
    """The states of a dataset, in its own directory."""

    spec: DatasetSpec

    def __init__(self, spec: DatasetSpec, data_dir: Path) -> None:
        directory = spec.directory(data_dir)
        title = f"{spec.scenario.name}, {spec.num_objects} objects"
        super().__init__(spec, directory, title=title, command=spec.command(directory))

    @property
    def id(self) -> str:
        """Name of the dataset."""
        return self.spec.id

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Search and simulate the experiments of a shard."""
        experiments: list[Experiment] = []
        with Simulator() as simulator:
            for first in self.spec.experiments_of_shard(shard)[::2]:
                experiments += self.spec.scenario.twin_pair(
                    self.spec.num_objects, seed=self.spec.seed, pair=first // 2, simulator=simulator
                )
                advance(2)
        path.write_bytes(encode(to_arrays(experiments, self.spec.experiments_of_shard(shard), self.spec)))
        return {"simulations": simulator.num_simulations}

    def check(self, path: Path, shard: int) -> None:
        """Read it all."""
        decode(path.read_bytes(), shard, self.spec)

    def write_manifest(self) -> None:
        """Vouch for a finished set, and say what it is."""
        super().write_manifest()
        write_card(self.spec, self.directory, f"not run yet, `{self.command.replace('generate.py', 'audit.py')}`")

    def description(self) -> dict[str, Any]:
        """Configuration and names of the strata."""
        spec = self.spec
        return {
            "id": spec.id,
            "configuration": spec.generating_configuration(),
            "strata": list(spec.scenario.strata()),
        }

    def read(self, shard: int, checksum: str) -> dict[str, np.ndarray]:
        """The arrays of one shard, whose checksum the manifest gives."""
        with self.explained(shard):
            self.verify(shard, checksum)
            return decode(self.path(shard).read_bytes(), shard, self.spec)

    def load(self) -> dict[str, np.ndarray]:
        """All arrays, experiments in order; every shard is checked against its checksum."""
        checksums = self.finished_checksums()
        shards = [self.read(shard, checksums[self.path(shard).name]) for shard in range(self.spec.num_shards)]
        return {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0]}


def layout(spec: DatasetSpec) -> dict[str, tuple[tuple[int, ...], str]]:
    """Arrays of a shard: shape of one experiment and dtype. Sequence 0 is observed (AB), 1 counterfactual (CD).

    states: position, quaternion_xyzw, linear and angular velocity at the state rate. object_index: place in the
    scenario's own order (towers: bottom to top), which `configuration` refers to; -1 where the slot is empty.
    do_operation: index into the scenario's do_operations, with the slot and offset (m) it concerns.
    """
    slots, times = spec.scenario.num_slots, spec.scenario.clock.num_states
    return {
        "states": ((2, times, slots, 13), "<f4"),
        "presence": ((2, slots), "|b1"),
        "shape": ((slots,), "|u1"),
        "object_index": ((slots,), "|i1"),
        "mass": ((slots,), "<f4"),
        "friction": ((slots,), "<f4"),
        "restitution": ((slots,), "<f4"),
        "gravity": ((3,), "<f4"),
        "configuration": ((), "<i4"),
        "seen": ((), "|b1"),
        "do_operation": ((), "|u1"),
        "do_slot": ((), "|u1"),
        "do_offset": ((3,), "<f4"),
        "stratum": ((), "|u1"),
        "twin": ((), "<i4"),
        "split": ((), "|u1"),
        "background_seed": ((), "<i4"),
        "pair_simulations": ((), "<i4"),
    }


def to_arrays(experiments: Sequence[Experiment], indices: Sequence[int], spec: DatasetSpec) -> dict[str, np.ndarray]:
    """Stack experiments, which have these indices in the dataset."""
    arrays = {name: np.zeros((len(indices), *shape), dtype) for name, (shape, dtype) in layout(spec).items()}
    arrays["object_index"][:] = -1
    arrays["twin"][:] = np.array(indices) // 2
    arrays["split"][:] = split_of_experiments(spec.num_experiments, spec.seed)[list(indices)]
    seen = seen_configurations(spec.scenario.confounders.num_configurations(spec.num_objects), spec.seed)
    for row, experiment in enumerate(experiments):
        for name, value in _fields(experiment, spec).items():
            arrays[name][row] = value
        arrays["seen"][row] = seen[experiment.configuration]
        for index, body in enumerate(experiment.scene.objects):
            arrays["object_index"][row, body.slot] = index
            arrays["shape"][row, body.slot] = body.shape
            for name in ("mass", "friction", "restitution"):
                arrays[name][row, body.slot] = getattr(body, name)
    return arrays


def _fields(experiment: Experiment, spec: DatasetSpec) -> dict[str, Any]:
    operation = experiment.do_operation
    sequences = (experiment.observed, experiment.counterfactual)
    return {
        "states": np.stack([sequence.states for sequence in sequences]),
        "presence": np.stack([sequence.presence for sequence in sequences]),
        "gravity": experiment.scene.gravity,
        "configuration": experiment.configuration,
        "do_operation": spec.scenario.do_operations.index(experiment.do_operation_name),
        "do_slot": operation.slot,
        "do_offset": operation.offset_m if isinstance(operation, Displace) else 0.0,
        "stratum": experiment.stratum,
        "background_seed": experiment.background_seed,
        "pair_simulations": experiment.pair_simulations,
    }


def encode(arrays: dict[str, np.ndarray]) -> bytes:
    """The bytes of a shard, the same for the same arrays (no timestamps)."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:
        for name, array in arrays.items():
            chunks = (1, *array.shape[1:]) if name == "states" else None
            compression = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if chunks else {}
            file.create_dataset(name, data=array, chunks=chunks, track_times=False, **compression)
    return buffer.getvalue()


def decode(content: bytes, shard: int, spec: DatasetSpec) -> dict[str, np.ndarray]:
    """The arrays of a shard. Only plain arrays of the expected shape and type are read; nothing outside the bytes is.

    Raises DamagedShardError when something is missing, cut off or not what the spec says.
    """
    count = len(spec.experiments_of_shard(shard))
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            arrays = {
                name: np.asarray(dataset_in(file, name, (count, *shape), dtype)[()])
                for name, (shape, dtype) in layout(spec).items()
            }
    except (OSError, KeyError, RuntimeError) as error:
        raise DamagedShardError(" ".join(str(error).split())) from error
    for name, (first, end) in _ranges(spec).items():
        outside = arrays[name][(arrays[name] < first) | (arrays[name] >= end)]
        if len(outside):
            raise DamagedShardError(f"'{name}' holds {outside[0]}, expected {first} to {end - 1}")
    counted = [-1] * (spec.scenario.num_slots - spec.num_objects) + list(range(spec.num_objects))
    if (np.sort(arrays["object_index"], axis=1) != counted).any():
        raise DamagedShardError(f"'object_index' does not count {spec.num_objects} objects")
    if ((arrays["shape"] > 0) != (arrays["object_index"] >= 0)).any():
        raise DamagedShardError("'shape' is given for other slots than 'object_index'")
    return arrays


def _ranges(spec: DatasetSpec) -> dict[str, tuple[int, int]]:
    """First and end of what an array that points at something may hold."""
    scenario = spec.scenario
    return {
        "shape": (0, max(Shape) + 1),
        "configuration": (0, scenario.confounders.num_configurations(spec.num_objects)),
        "do_operation": (0, len(scenario.do_operations)),
        "do_slot": (0, scenario.num_slots),
        "stratum": (0, len(scenario.strata())),
        "twin": (0, spec.num_experiments // 2),
        "split": (0, len(SPLITS)),
    }
