"""Forecasts of the oracles for the first test experiments, stored in shards next to the states."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.shards import Field, Fields, ShardSet, empty_arrays, encode
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import States, make_twins, stable_frames
from cophy.errors import CophyError
from cophy.oracles.posterior import Outcomes, posterior, resample
from cophy.scenario import Scenario, Trajectory
from cophy.scenario.physics import Scene
from cophy.scenario.simulator import CachingSimulator

VERSION = 3  # raise it when other hypotheses are tried
USUAL_STABLE_SPEED = 0.1  # m/s, of every scenario (conf/scenario); forecasts at another one have their own directory
STORED_PRECISION_M = 1e-4  # positions are stored with less error


# docs/benchmark/metrics.md; the last two know everything and show how far D depends on the solver and on rounding
ORACLES = ("feedforward", "initial_velocity", "confounders", "counterfactual", "double_rate", "jitter")
SECONDS_PER_EXPERIMENT = 9.0  # of CPU time, estimated
JITTER_M = 1e-4  # ours: largest error of each horizontal coordinate of C; positions are stored to a micrometre


@dataclass
class OracleSettings:
    """Settings of the oracles, explained in conf/model/.

    draws: samples of D where the possible outcomes are not enumerated. max_configurations: confounder configurations that
    are fitted to AB. noise: assumed error of every observed coordinate, m. max_experiments: the number of test experiments.
    """

    draws: int
    max_configurations: int
    noise: float
    max_experiments: int

    def __post_init__(self) -> None:
        if self.draws < 4:
            raise ValueError("model.draws must be at least 4: the variance of a mean needs two twin pairs")
        if self.max_configurations < 1 or self.noise <= 0:
            raise ValueError("model: max_configurations must be at least 1 and noise positive")
        if self.max_experiments < 2 or self.max_experiments % 2:
            raise ValueError("model.max_experiments must be even and at least 2, so that both twins are included")


class OracleForecasts(ShardSet):
    """Forecasts of each of ORACLES for the first experiments of the test split, as many as the settings say.

    experiment: (experiment,) their indices in the dataset. <oracle>_position: (experiment, T-1, K, 3), the mean of D, metres.
    <oracle>_draw_variance: the same shape, the variance that this mean owes to the draws that it is of, m².
    <oracle>_stable: (experiment, T-1, K), the probability that an object is stable.
    """

    spec: DatasetSpec

    def __init__(self, states: ExperimentSet, settings: OracleSettings) -> None:
        """Raise CophyError if the data were released by others."""
        if not isinstance(states, States):
            raise CophyError("oracles simulate generated data: released data lack what a simulation starts from")
        self.spec = spec = states.spec
        self.states, self.settings = states, settings
        values = {field.name: getattr(settings, field.name) for field in fields(OracleSettings)}
        self.content = {name: values[name] for name in ("draws", "max_configurations", "noise")}
        if (stable_speed := spec.scenario.task.stable_speed) != USUAL_STABLE_SPEED:
            self.content["stable_speed"] = stable_speed
        if len(self._test_experiments()) > settings.max_experiments:
            self.content["max_experiments"] = settings.max_experiments
        text = json.dumps({"version": VERSION, **self.content}, sort_keys=True)
        name = f"oracles-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        keys = " ".join(f"model.{key}={value}" for key, value in values.items())
        command = f"{states.command} model=oracle_feedforward {keys}"  # generates the forecasts of all oracles
        super().__init__(spec, states.directory / name, title=f"oracles of {states.title}", command=command)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Simulate possible outcomes of every twin pair of the shard's test experiments."""
        rows, fields = self._rows(shard), self.fields(shard)
        arrays, stored = self.states.read(shard), empty_arrays(fields)
        first = self.spec.experiments_of_shard(shard)[0]
        stored["experiment"][:] = self.experiments(shard)
        with CachingSimulator() as simulator:
            for index in range(0, len(rows), 2):
                simulator.clear_cache()  # twins share scenes, pairs do not
                observed = self._observed(arrays, rows[index : index + 2])
                pair = int(self.spec.order.pair[first + rows[index]])
                for twin, by_oracle in enumerate(self._of_pair(pair, observed, simulator)):
                    for oracle, hypotheses in by_oracle.items():
                        for name, value in forecast_of(hypotheses, self.spec.scenario).items():
                            stored[f"{oracle}_{name}"][index + twin] = value
                advance(2)
        path.write_bytes(encode(stored, fields, self.attributes(shard)))
        return {"simulations": simulator.num_simulations}

    def cost(self, experiments: int) -> tuple[float, float]:
        return experiments * SECONDS_PER_EXPERIMENT, 0.0

    def experiments(self, shard: int) -> list[int]:
        return (self._rows(shard) + self.spec.experiments_of_shard(shard)[0]).tolist()

    def fields(self, shard: int) -> Fields:
        scenario, count = self.spec.scenario, len(self._rows(shard))
        steps = (count, scenario.clock.num_frames - 1, scenario.num_slots)
        fields = {"experiment": Field((count,), "<i4")}
        for oracle in ORACLES:
            fields |= {f"{oracle}_{name}": Field((*steps, 3), "<f4") for name in ("position", "draw_variance")}
            fields[f"{oracle}_stable"] = Field(steps, "<f4")
        return fields

    def description(self) -> dict[str, Any]:
        """Return the dataset and the settings of the oracles."""
        return {"dataset": self.spec.id, "version": VERSION, **self.content}

    def _of_pair(self, pair: int, observed: np.ndarray, simulator: CachingSimulator) -> Iterator[dict[str, Outcomes]]:
        """Yield the hypotheses of both twins, by oracle; twins share those given only A, C, the do-operation and velocities.

        Both twins are simulated again, because rounding them to what is stored would change how some towers fall.

        Args:
            pair: Index of the twin pair in the dataset.
            observed: (twin, T, K, 3) stored positions in AB, metres.

        Raises:
            CophyError: The stored pair is another one.
        """
        scenario, settings = self.spec.scenario, self.settings
        twins = make_twins(self.spec, pair, simulator)
        for twin, seen in zip(twins, observed, strict=True):
            self._check_same(twin.observed, seen)
        scene, do_operation = twins[0].scene, twins[0].do_operation

        def resampled(kind: int, index: int, **known: Any) -> Outcomes:
            rng = np.random.default_rng((kind, index))
            return resample(scenario, scene, do_operation, draws=settings.draws, rng=rng, simulator=simulator, **known)

        finer = replace(scenario, solver=replace(scenario.solver, step_rate_hz=2 * scenario.solver.step_rate_hz))
        alike = resampled(0, pair)
        at_rest = scene == scene.at_rest()  # then the initial velocity is known anyway
        moving = alike if at_rest else resampled(1, pair, velocity_known=True)
        for number, (twin, seen) in enumerate(zip(twins, observed, strict=True)):
            index = 2 * pair + number
            rng = np.random.default_rng((3, index))
            yield {
                "feedforward": alike,
                "initial_velocity": moving,
                "confounders": resampled(2, index, configuration=twin.configuration),
                "counterfactual": posterior(
                    scenario,
                    twin.scene,
                    do_operation,
                    seen,
                    draws=settings.draws,
                    max_configurations=settings.max_configurations,
                    noise=settings.noise,
                    rng=rng,
                    simulator=simulator,
                ),
                "double_rate": Outcomes.certain(finer.simulate(simulator, do_operation.apply(twin.scene))),
                "jitter": Outcomes.certain(
                    scenario.simulate(
                        simulator, _jittered(do_operation.apply(twin.scene), np.random.default_rng((4, index)))
                    )
                ),
            }

    def _observed(self, arrays: dict[str, np.ndarray], rows: np.ndarray) -> np.ndarray:
        """(experiment, T, K, 3) positions in AB, metres."""
        stride = self.spec.scenario.clock.states_per_frame
        return np.asarray(arrays["states"][rows, 0, ::stride, :, :3].astype(np.float64))

    def _check_same(self, made: Trajectory, seen: np.ndarray) -> None:
        if not np.allclose(made.positions[0], seen[0], atol=STORED_PRECISION_M):
            raise CophyError(
                f"{self.states.directory} was made by other code: oracles make its test experiments again, and they came "
                f"out otherwise. Delete it and run `{self.states.command}`"
            )

    def _test_experiments(self) -> np.ndarray:
        """Return the indices of the test experiments in the dataset, twins next to each other, the first one first."""
        order = self.spec.order
        indices = np.lexsort((order.second, order.pair))
        return indices[order.split[indices] == SPLITS.index("test")]

    def _rows(self, shard: int) -> np.ndarray:
        """Return the rows of a shard that have forecasts, in the order of `_test_experiments`."""
        indices, within = (
            self._test_experiments()[: self.settings.max_experiments],
            self.spec.experiments_of_shard(shard),
        )
        return indices[(indices >= within[0]) & (indices <= within[-1])] - within[0]


def _jittered(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return the scene with every object off by up to JITTER_M in x and y."""
    for body in scene.objects:
        x, y = (np.array(body.position[:2]) + rng.uniform(-JITTER_M, JITTER_M, 2)).tolist()
        scene = scene.with_object(replace(body, position=(x, y, body.position[2])))
    return scene


def forecast_of(hypotheses: Outcomes, scenario: Scenario) -> dict[str, np.ndarray]:
    """The mean of D, the variance that it owes to draws, and the probability of being stable; see `OracleForecasts`."""
    stride, states = scenario.clock.states_per_frame, hypotheses.states
    position = states[:, ::stride, :, :3][:, 1:]
    return {
        "position": hypotheses.mean(position),
        "draw_variance": hypotheses.variance_of_mean(position),
        "stable": hypotheses.mean(stable_frames(states, stride, scenario.task.stable_speed)),
    }
