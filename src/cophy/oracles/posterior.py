"""What D could be: with AB, by the posterior over configurations of confounders; without AB, by sampling as the search does.

The posterior tries all configurations where that is affordable, and otherwise searches for the most likely ones. The true
configuration is never used.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.oracles.priors import configuration_prior, unknown_scenario, velocity_inference
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.experiment import DoOperation
from cophy.scenario.physics import Scene, Trajectory
from cophy.scenario.scenario import Scenario
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.simulator import Simulator


@dataclass(frozen=True)
class Outcomes:
    """Possible D with their probabilities.

    Attributes:
        counterfactuals: Trajectories of D.
        weight: (hypothesis,) their probabilities.
        draw: (hypothesis,) index of the independent draw that each comes from; twins come from one draw. None if the
            hypotheses are enumerated.
    """

    counterfactuals: list[Trajectory]
    weight: np.ndarray
    draw: np.ndarray | None = None

    @classmethod
    def certain(cls, counterfactual: Trajectory) -> "Outcomes":
        """Return the only possibility."""
        return cls([counterfactual], np.ones(1))

    @classmethod
    def drawn(cls, draws: list[list[Trajectory]]) -> "Outcomes":
        """Return the hypotheses of independent draws, which have equally many trajectories each."""
        draw = np.repeat(np.arange(len(draws)), [len(each) for each in draws])
        trajectories = [trajectory for each in draws for trajectory in each]
        return cls(trajectories, np.full(len(trajectories), 1 / len(trajectories)), draw)

    @cached_property
    def states(self) -> np.ndarray:
        """States, (hypothesis, time, slot, 13), see `Trajectory.states`."""
        return np.stack([trajectory.states for trajectory in self.counterfactuals])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the weighted mean of values over hypotheses, the first axis."""
        return np.asarray(np.average(values, axis=0, weights=self.weight))

    def variance_of_mean(self, values: np.ndarray) -> np.ndarray:
        """Return an unbiased estimate of the sampling variance of the mean; 0 if the hypotheses are enumerated.

        The draws are independent, so it is the variance between the means of draws, divided by their number.
        """
        if self.draw is None:
            return np.zeros(values.shape[1:])
        count = int(self.draw.max()) + 1
        means = np.stack([values[self.draw == draw].mean(axis=0) for draw in range(count)])
        return np.asarray(means.var(axis=0, ddof=1) / count)


def posterior(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    observed: np.ndarray,
    *,
    draws: int,
    max_configurations: int,
    noise: float,
    rng: np.random.Generator,
    simulator: Simulator,
) -> Outcomes:
    """Return hypotheses about D given AB.

    Args:
        scene: A; its confounders are not used, and its velocities only as the start of fits.
        observed: (T, K, 3) positions of AB at the frame rate, metres; the first frames also determine the initial velocities.
        draws: Number of configurations, drawn from the prior, from which a search starts if not all are tried; and number
            of sampled D if more configurations than that explain AB.
        max_configurations: Up to this number of configurations (towers: of masses and gravity), all are tried; otherwise it
            limits how many are tried.
        noise: Standard deviation of the independent error of every observed coordinate, metres.
        simulator: Use a caching simulator: samples repeat, and twins share A.
    """
    with_velocities = velocity_inference(scenario, scene, observed, simulator)
    scene = scene.at_rest()
    prior = configuration_prior(scenario, scene, do_operation)
    search = ConfigurationSearch(
        scenario, scene, observed, prior, noise=noise, with_velocities=with_velocities, simulator=simulator
    )
    groups = search.alike_at_first(np.flatnonzero(prior).tolist())
    if len(groups) <= max_configurations:
        explanations = search.enumerated(groups)
    else:
        start = rng.choice(len(prior), draws, p=prior)
        explanations = search.searched(np.unique(start).tolist(), max_configurations)
    log_probability = np.array([each.log_probability for each in explanations])
    weight = np.exp(log_probability - log_probability.max())
    weight /= weight.sum()

    def counterfactual(index: int) -> Trajectory:
        return scenario.simulate(simulator, do_operation.apply(explanations[index].scene))

    if len(weight) > draws:
        sample = np.sort(rng.choice(len(weight), draws, p=weight))
        return Outcomes.drawn([[counterfactual(int(index))] for index in sample])
    return Outcomes([counterfactual(index) for index in range(len(weight))], weight)


# of initial velocities and two configurations, until one more pair fits; ours: for one ball without neighbours, one try in 750
# fits. Without any success, this takes five minutes
MAX_TRIES = 10_000


def resample(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    *,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
    velocity_known: bool = False,
    configuration: int | None = None,
) -> Outcomes:
    """Return CD of experiments that the search could have generated with the same A and C.

    Args:
        scene: A; its confounders are not used, and its velocities only if they are known.
        draws: Number of CD; half as many if the configuration is known, because the twin's CD does not count.
        rng: The source of randomness of confounders and initial velocities.
        velocity_known: Whether the initial velocities are those of the scene, instead of drawn.
        configuration: The confounders, instead of drawn ones.

    Raises:
        CophyError: The oracles do not know the scenario, or its search cannot have generated this A.
    """
    if isinstance(scenario, Blocktower):  # towers start at rest, so the configuration is all that is drawn
        if configuration is not None:
            known = scenario.simulate(simulator, do_operation.apply(scenario.with_configuration(configuration, scene)))
            return Outcomes.certain(known)
        prior = configuration_prior(scenario, scene, do_operation)
        sample = np.sort(rng.choice(len(prior), draws, p=prior)).tolist()
        scenes = {c: do_operation.apply(scenario.with_configuration(c, scene)) for c in sample}
        trajectories = {c: scenario.simulate(simulator, scene) for c, scene in scenes.items()}
        return Outcomes.drawn([[trajectories[c]] for c in sample])
    if not isinstance(scenario, SimulatedSearch):
        raise unknown_scenario(scenario)
    pairs = [
        _resample_twins(scenario, scene, do_operation, rng, simulator, velocity_known, configuration)
        for _ in range(draws // 2)
    ]
    return Outcomes.drawn([list(twins if configuration is None else twins[:1]) for twins in pairs])


def _resample_twins(
    scenario: SimulatedSearch,
    scene: Scene,
    do_operation: DoOperation,
    rng: np.random.Generator,
    simulator: Simulator,
    velocity_known: bool,
    configuration: int | None,
) -> tuple[Trajectory, Trajectory]:
    """Return CD of both twins, found as `search` finds them, with A, the do-operation and what is known fixed."""
    count = scenario.confounders.num_configurations(len(scene.objects))
    for _ in range(MAX_TRIES):
        moving = scene if velocity_known else scene.with_velocities(scenario.sample_velocities(scene, rng))
        first = int(rng.integers(count)) if configuration is None else configuration
        second = (first + 1 + int(rng.integers(count - 1))) % count
        twins = [scenario.with_configuration(c, moving) for c in (first, second)]
        observed = scenario.simulate_twins(twins, simulator)
        if observed is None:
            continue
        both = scenario.simulate_twins([do_operation.apply(twin) for twin in twins], simulator, observed)
        if both is not None:
            return both
    raise CophyError(
        f"no {scenario.name} twins fit this scene in {MAX_TRIES} tries: it was not generated with this configuration"
    )


FIRST_SHARES = (0.2, 0.3, 0.5)  # of AB's frames, which are compared before all of them
MAX_LOG_RATIO = 30.0  # to the most likely configuration; one that is less likely after the first frames is dropped
NUM_GROUPED = 2  # number of these shares in which one configuration stands for all that hardly differ from it
MAX_GROUP_LOG_RATIO = 4 * MAX_LOG_RATIO  # the same for groups, of which other members may be more likely
NEGLIGIBLE_LOG_RATIO = float(np.log(100))  # a configuration that is less likely than this does not change a mean


@dataclass(frozen=True)
class Explanation:
    """A configuration that may explain AB.

    Attributes:
        scene: A under the configuration, with the initial velocities that fit best.
        log_probability: Log of the posterior, not normalised.
    """

    scene: Scene
    log_probability: float


class ConfigurationSearch:
    """Comparison of AB with simulations under configurations.

    More and more frames of AB are compared. A configuration that is unlikely after the first ones is not simulated further.

    Args:
        at_rest: A without velocities; its confounders are not used.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        prior: (configuration,) probabilities.
        noise: Standard deviation of every observed coordinate, metres.
        with_velocities: See `velocity_inference`.
    """

    def __init__(
        self,
        scenario: Scenario,
        at_rest: Scene,
        observed: np.ndarray,
        prior: np.ndarray,
        *,
        noise: float,
        with_velocities: Callable[[Scene], Scene],
        simulator: Simulator,
    ) -> None:
        self.scenario, self.at_rest, self.observed, self.prior = scenario, at_rest, observed, prior
        self.noise, self.with_velocities, self.simulator = noise, with_velocities, simulator
        self._scene: dict[int, Scene] = {}
        num_frames = scenario.clock.num_frames
        self._lengths = [*(max(2, round(share * num_frames)) for share in FIRST_SHARES), num_frames]

    def alike_at_first(self, configurations: Iterable[int]) -> list[list[int]]:
        """Return groups of configurations whose AB start alike: of towers, those with the same masses and gravity.

        Masses and gravity decide whether and where a tower topples; friction has an effect only later.
        """
        groups = dict[Any, list[int]]()
        for configuration in configurations:
            truth = self.scenario.confounders.decode(configuration, len(self.at_rest.objects))
            key = configuration if self.scenario.statics is None else (truth.mass, truth.gravity_xy)
            groups.setdefault(key, []).append(configuration)
        return list(groups.values())

    def enumerated(self, groups: list[list[int]]) -> list[Explanation]:
        """Return the posterior over all these configurations.

        Args:
            groups: See `alike_at_first`. The first of a group stands for all in the first frames, and in all frames of a
                tower that does not fall.
        """
        group_of, stands = {group[0]: group for group in groups}, self._tower_stands()
        remaining = list(group_of)
        for num_frames in self._lengths if stands else self._lengths[:NUM_GROUPED]:
            tried = self._tried(remaining, num_frames)
            remaining = self._within(tried, MAX_GROUP_LOG_RATIO)
        remaining = [configuration for first in remaining for configuration in group_of[first]]
        if stands:
            return self._explanations({c: tried[first] for first in tried for c in group_of[first]})
        for num_frames in self._lengths[NUM_GROUPED - 1 :]:
            tried = self._tried(remaining, num_frames)
            remaining = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tower_stands(self) -> bool:
        """Return whether AB shows a tower that does not fall."""
        statics = self.scenario.statics
        moved = np.linalg.norm(self.observed - self.observed[0], axis=-1).max()
        return statics is not None and bool(moved < statics.fallen_distance)

    def searched(self, start: Iterable[int], max_configurations: int) -> list[Explanation]:
        """Return the posterior over the configurations that a search visits.

        Args:
            start: The configurations where it starts.
            max_configurations: How many are tried, over all numbers of frames.
        """
        remaining, at_once = list(start), -(-max_configurations // len(self._lengths))
        for num_frames in self._lengths:
            tried = self._tried(remaining[:at_once], num_frames)
            self._climb(tried, num_frames, at_once)
            remaining = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tried(self, configurations: Iterable[int], num_frames: int) -> dict[int, float]:
        return {c: self._log_probability(c, num_frames) for c in configurations}

    def _climb(self, tried: dict[int, float], num_frames: int, max_configurations: int) -> None:
        """Try the neighbours of the most likely configurations, the most likely first.

        It ends when the best explains AB so well that none can be far more likely, and the neighbours of all that are nearly
        as likely were tried.
        """
        expanded, enough = set[int](), float(np.log(self.prior.max())) - NEGLIGIBLE_LOG_RATIO
        while len(tried) < max_configurations:
            best = max((c for c in tried if c not in expanded), key=tried.__getitem__, default=None)
            most = max(tried.values())
            if best is None or (most >= enough and tried[best] < most - NEGLIGIBLE_LOG_RATIO):
                return
            expanded.add(best)
            for neighbour in self.scenario.confounders.neighbours(best, len(self.at_rest.objects)):
                if neighbour not in tried and self.prior[neighbour] > 0:
                    tried[neighbour] = self._log_probability(neighbour, num_frames)

    def _within(self, tried: dict[int, float], log_ratio: float) -> list[int]:
        """Return the configurations that are at most so much less likely than the most likely one, which comes first."""
        least = max(tried.values()) - log_ratio
        return [c for c in sorted(tried, key=tried.__getitem__, reverse=True) if tried[c] >= least]

    def _explanations(self, tried: dict[int, float]) -> list[Explanation]:
        return [Explanation(self._moving(c), tried[c]) for c in self._within(tried, NEGLIGIBLE_LOG_RATIO)]

    def _moving(self, configuration: int) -> Scene:
        """Return A under a configuration, with the initial velocities that fit best."""
        if configuration not in self._scene:
            self._scene[configuration] = self.with_velocities(
                self.scenario.with_configuration(configuration, self.at_rest)
            )
        return self._scene[configuration]

    def _log_probability(self, configuration: int, num_frames: int) -> float:
        """Return the log of prior × likelihood of the first frames, with independent errors of all coordinates."""
        clock = replace(self.scenario.clock, num_frames=num_frames)
        simulated = self.simulator.simulate(
            self._moving(configuration), solver=self.scenario.solver, clock=clock, num_slots=self.scenario.num_slots
        )
        frames = simulated.positions[:: clock.states_per_frame]
        squared = np.square(frames - self.observed[:num_frames])[:, simulated.presence].sum()
        return float(np.log(self.prior[configuration]) - squared / (2 * self.noise**2))
