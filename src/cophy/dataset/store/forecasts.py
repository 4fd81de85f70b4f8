"""What the two oracles say of every test experiment, in shards beside the states: it takes simulations, so it is kept."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, split_of_experiments
from cophy.dataset.state_features import stable_frames
from cophy.dataset.store.experiment_set import ExperimentSet, OracleSettings
from cophy.dataset.store.hdf5_arrays import Field, Fields, empty_arrays, encode
from cophy.dataset.store.shardset import ShardSet
from cophy.scenario import Simulator
from cophy.scenario.oracles.posterior import Hypothesis, counterfactual_hypotheses, feedforward_hypotheses

VERSION = 1  # raise it when other hypotheses are tried
ORACLES = ("feedforward", "counterfactual")


class OracleForecasts(ShardSet):
    """By each of ORACLES, for the experiments of the test split.

    experiment: (experiment,) their indices in the dataset. <oracle>_position: (experiment, T-1, K, 3), the mean of D, metres.
    <oracle>_stable: (experiment, T-1, K), the probability that an object is stable.
    """

    spec: DatasetSpec

    def __init__(self, states: ExperimentSet, spec: DatasetSpec, settings: OracleSettings) -> None:
        self.states, self.settings = states, settings
        text = json.dumps({"version": VERSION, **asdict(settings)}, sort_keys=True)
        name = f"oracles-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        command = f"python src/train.py scenario={spec.scenario.name} 'model=glob(oracle_*)' -m"
        super().__init__(spec, states.directory / name, title=f"oracles of {states.title}", command=command)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Simulate what could be, for every twin pair of the shard that is tested on."""
        rows, fields = self._rows(shard), self.fields(shard)
        arrays, stored = self.states.read(shard), empty_arrays(fields)
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
        path.write_bytes(encode(stored, fields))
        return {"simulations": simulator.num_simulations}

    def fields(self, shard: int) -> Fields:
        scenario, count = self.spec.scenario, len(self._rows(shard))
        steps = (count, scenario.clock.num_frames - 1, scenario.num_slots)
        fields = {"experiment": Field((count,), "<i4")}
        for oracle in ORACLES:
            fields |= {f"{oracle}_position": Field((*steps, 3), "<f4"), f"{oracle}_stable": Field(steps, "<f4")}
        return fields

    def description(self) -> dict[str, Any]:
        """What was asked of the oracles."""
        return {"dataset": self.spec.id, "version": VERSION, **asdict(self.settings)}

    def _without(self, arrays: dict[str, np.ndarray], row: int, first: int, simulator: Simulator) -> list[Hypothesis]:
        return feedforward_hypotheses(
            self.spec.scenario,
            scene_of(arrays, row, self.spec.scenario),
            do_operation_of(arrays, row, self.spec.scenario),
            draws=self.settings.draws,
            rng=np.random.default_rng((0, first + row)),
            simulator=simulator,
        )

    def _with(self, arrays: dict[str, np.ndarray], row: int, first: int, simulator: Simulator) -> list[Hypothesis]:
        stride = self.spec.scenario.clock.states_per_frame
        return counterfactual_hypotheses(
            self.spec.scenario,
            scene_of(arrays, row, self.spec.scenario),
            do_operation_of(arrays, row, self.spec.scenario),
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
        split = split_of_experiments(self.spec.num_experiments, self.spec.data_seed)
        return np.flatnonzero(split[list(self.spec.experiments_of_shard(shard))] == SPLITS.index("test"))
