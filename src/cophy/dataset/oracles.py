"""What the two oracles say of every test experiment, in shards beside the states: it takes simulations, so it is kept."""

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cophy.dataset.counterfactual import stable_frames
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.shardset import DamagedShardError, ShardSet, dataset_in
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, split_of_experiments
from cophy.dataset.states import States
from cophy.scenario import Simulator
from cophy.scenario.hypotheses import Hypothesis, with_observation, without_observation

VERSION = 1  # raise it when other hypotheses are tried
ORACLES = ("feedforward", "counterfactual")


@dataclass(frozen=True)
class OracleSettings:
    """draws: of confounders per experiment. noise: m, how far AB may be off; both explained in conf/model/."""

    draws: int
    noise: float


class OracleForecasts(ShardSet):
    """For the test split: position (experiment, T-1, K, 3), the mean of D in metres, and stable (experiment, T-1, K), the
    probability that an object is stable, by each of ORACLES. experiment: (experiment,) their indices in the dataset.
    """

    spec: DatasetSpec

    def __init__(self, states: States, settings: OracleSettings) -> None:
        self.states, self.settings = states, settings
        text = json.dumps({"version": VERSION, **asdict(settings)}, sort_keys=True)
        name = f"oracles-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        command = f"python src/train.py scenario={states.spec.scenario.name} 'model=glob(oracle_*)' -m"
        super().__init__(states.spec, states.directory / name, title=f"oracles of {states.title}", command=command)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Simulate what could be, for every twin pair of the shard that is tested on."""
        rows = self._rows(shard)
        checksum = self.states.finished_checksums()[self.states.path(shard).name]
        arrays = self.states.read(shard, checksum)
        stored = {name: np.zeros(shape, dtype) for name, (shape, dtype) in self._layout(shard).items()}
        first = self.spec.experiments_of_shard(shard)[0]
        stored["experiment"][:] = rows + first
        with Simulator() as simulator:
            for index, row in enumerate(rows.tolist()):
                if index % 2 == 0:  # twins share all that the feedforward oracle sees
                    alike = self._without(arrays, row, first, simulator)
                found = {"feedforward": alike, "counterfactual": self._with(arrays, row, first, simulator)}
                for oracle, hypotheses in found.items():
                    for name, value in self._mean(hypotheses).items():
                        stored[f"{oracle}_{name}"][index] = value
                advance(1)
        advance(len(self.spec.experiments_of_shard(shard)) - len(rows))
        path.write_bytes(_encode(stored))
        return {"simulations": simulator.num_simulations}

    def check(self, path: Path, shard: int) -> None:
        """Read it all."""
        self._read(path, shard)

    def description(self) -> dict[str, Any]:
        """What was asked of the oracles."""
        return {"dataset": self.spec.id, "version": VERSION, **asdict(self.settings)}

    def load(self) -> dict[str, np.ndarray]:
        """All arrays, test experiments in order."""
        checksums = self.finished_checksums()
        shards = []
        for shard in range(self.spec.num_shards):
            with self.explained(shard):
                self.verify(shard, checksums[self.path(shard).name])
                shards.append(self._read(self.path(shard), shard))
        return {name: np.concatenate([arrays[name] for arrays in shards]) for name in shards[0]}

    def _without(self, arrays: dict[str, np.ndarray], row: int, first: int, simulator: Simulator) -> list[Hypothesis]:
        return without_observation(
            self.spec.scenario,
            scene_of(arrays, row, self.spec.scenario),
            do_operation_of(arrays, row),
            draws=self.settings.draws,
            rng=np.random.default_rng((0, first + row)),
            simulator=simulator,
        )

    def _with(self, arrays: dict[str, np.ndarray], row: int, first: int, simulator: Simulator) -> list[Hypothesis]:
        stride = self.spec.scenario.clock.states_per_frame
        return with_observation(
            self.spec.scenario,
            scene_of(arrays, row, self.spec.scenario),
            do_operation_of(arrays, row),
            arrays["states"][row, 0, ::stride, :, :3].astype(np.float64),
            draws=self.settings.draws,
            noise=self.settings.noise,
            rng=np.random.default_rng((1, first + row)),
            simulator=simulator,
        )

    def _mean(self, hypotheses: list[Hypothesis]) -> dict[str, np.ndarray]:
        scenario = self.spec.scenario
        weight = np.array([hypothesis.weight for hypothesis in hypotheses])
        states = np.stack([hypothesis.counterfactual.states for hypothesis in hypotheses])
        stride = scenario.clock.states_per_frame
        stable = stable_frames(states, stride, scenario.task.stable_speed)
        values = {"position": states[:, ::stride, :, :3][:, 1:], "stable": stable}
        return {name: np.average(value, axis=0, weights=weight) for name, value in values.items()}

    def _rows(self, shard: int) -> np.ndarray:
        split = split_of_experiments(self.spec.num_experiments, self.spec.seed)
        return np.flatnonzero(split[list(self.spec.experiments_of_shard(shard))] == SPLITS.index("test"))

    def _layout(self, shard: int) -> dict[str, tuple[tuple[int, ...], str]]:
        scenario, count = self.spec.scenario, len(self._rows(shard))
        steps = (count, scenario.clock.num_frames - 1, scenario.num_slots)
        layout: dict[str, tuple[tuple[int, ...], str]] = {"experiment": ((count,), "<i4")}
        for oracle in ORACLES:
            layout |= {f"{oracle}_position": ((*steps, 3), "<f4"), f"{oracle}_stable": (steps, "<f4")}
        return layout

    def _read(self, path: Path, shard: int) -> dict[str, np.ndarray]:
        try:
            with h5py.File(path, "r") as file:
                layout = self._layout(shard)
                return {name: np.asarray(dataset_in(file, name, *what)[()]) for name, what in layout.items()}
        except (OSError, KeyError, RuntimeError) as error:
            raise DamagedShardError(" ".join(str(error).split())) from error


def _encode(arrays: dict[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, track_times=False)
    return buffer.getvalue()
