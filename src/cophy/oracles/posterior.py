"""Which configurations of confounders explain AB: all are tried where that can be afforded, else the likeliest are looked for.

What D could be, and how sure the mean of it is.
What D could be with AB: the posterior over configurations of confounders. The true ones are never used.
What D could be without AB: CD of experiments that the search could have made of the same A, C and do-operation.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, singledispatch
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.oracles.priors import configuration_prior, draw_initial_velocities, unknown_scenario, velocity_inference
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.experiment import DoOperation
from cophy.scenario.physics import Scene, Trajectory
from cophy.scenario.scenario import Scenario
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.simulator import Simulator


@dataclass(frozen=True)
class Hypotheses:
    """Possible D.

    counterfactuals: trajectories of D.
    weight: (hypothesis,) how likely each is; they sum to 1.
    draw: (hypothesis,) number of the independent draw that each came of. Twins come of one draw. None where nothing was drawn.
    """

    counterfactuals: list[Trajectory]
    weight: np.ndarray
    draw: np.ndarray | None = None

    @classmethod
    def drawn(cls, draws: list[list[Trajectory]]) -> "Hypotheses":
        """Those of independent draws, each of equally many trajectories."""
        draw = np.repeat(np.arange(len(draws)), [len(each) for each in draws])
        trajectories = [trajectory for each in draws for trajectory in each]
        return cls(trajectories, np.full(len(trajectories), 1 / len(trajectories)), draw)

    @cached_property
    def states(self) -> np.ndarray:
        """(hypothesis, time, slot, 13), see `Trajectory.states`."""
        return np.stack([trajectory.states for trajectory in self.counterfactuals])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean of a value per hypothesis (first axis)."""
        return np.asarray(np.average(values, axis=0, weights=self.weight))

    def variance_of_mean(self, values: np.ndarray) -> np.ndarray:
        """Unbiased estimate of the variance that the mean owes to the draws; 0 where nothing was drawn.

        The draws are independent, so it is the variance between the means of draws, divided by their number.
        """
        if self.draw is None:
            return np.zeros(values.shape[1:])
        count = int(self.draw.max()) + 1
        of_draw = np.stack([values[self.draw == draw].mean(axis=0) for draw in range(count)])
        return np.asarray(of_draw.var(axis=0, ddof=1) / count)


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
) -> Hypotheses:
    """Hypotheses about D with AB.

    Args:
        scenario: whose generator is meant.
        scene: A; its confounders are not looked at, and its velocities only as a start of fits.
        do_operation: what makes C of A.
        observed: (T, K, 3) positions of AB at the frame rate, metres; the first frames also tell the initial velocities.
        draws: from how many configurations of the prior a search starts, where not all are tried; and of how many D the
            mean is taken, where more configurations than that explain AB.
        max_configurations: so many possible configurations (towers: of masses and gravity) are all tried; of more, so many
            are tried at most.
        noise: metres; every coordinate of AB is taken to be off by so much, independently.
        rng: draws come from it.
        simulator: AB and D are simulated with it; it had better remember them, for draws recur and twins share A.
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
        chosen = np.sort(rng.choice(len(weight), draws, p=weight))
        return Hypotheses.drawn([[counterfactual(int(index))] for index in chosen])
    return Hypotheses([counterfactual(index) for index in range(len(weight))], weight)


# of initial velocities and two configurations, until one more pair fits; ours: of one ball that was left alone, one in 750 did.
# Where none ever does, this takes five minutes
MAX_TRIES = 10_000


@singledispatch
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
) -> Hypotheses:
    """CD of experiments as the search could have made them.

    Args:
        scenario: whose search is meant.
        scene: A; its confounders are not looked at, and its velocities only where they are known.
        do_operation: what makes C of A.
        draws: how many CD; half as many where the configuration is known, because its twin's CD does not count.
        rng: confounders and initial velocities are drawn from it.
        simulator: CD are simulated with it.
        velocity_known: whether the velocities are those of the scene, instead of drawn.
        configuration: the confounders, instead of drawn ones.

    Raises:
        CophyError: the oracles do not know the scenario, or its search cannot have made this A.
    """
    raise unknown_scenario(scenario)


@resample.register
def _towers(
    scenario: Blocktower,
    scene: Scene,
    do_operation: DoOperation,
    *,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
    velocity_known: bool = False,
    configuration: int | None = None,
) -> Hypotheses:
    """Towers start at rest, as everybody knows; so the configuration is all that there is to draw."""
    if configuration is not None:
        known = scenario.simulate(simulator, do_operation.apply(scenario.with_configuration(configuration, scene)))
        return Hypotheses([known], np.ones(1))
    prior = configuration_prior(scenario, scene, do_operation)
    drawn, counts = np.unique(rng.choice(len(prior), draws, p=prior), return_counts=True)
    found = [
        scenario.simulate(simulator, do_operation.apply(scenario.with_configuration(int(c), scene))) for c in drawn
    ]
    return Hypotheses.drawn(
        [[trajectory] for trajectory, count in zip(found, counts, strict=True) for _ in range(count)]
    )


@resample.register
def _simulated(
    scenario: SimulatedSearch,
    scene: Scene,
    do_operation: DoOperation,
    *,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
    velocity_known: bool = False,
    configuration: int | None = None,
) -> Hypotheses:
    """Twins are found as `search` finds them, with A, the do-operation and what is known held."""
    count = scenario.confounders.num_configurations(len(scene.objects))

    def both_of_a_pair() -> tuple[Trajectory, Trajectory]:
        for _ in range(MAX_TRIES):
            moving = scene if velocity_known else scene.with_velocities(draw_initial_velocities(scenario, scene, rng))
            twins = [scenario.with_configuration(c, moving) for c in _two_configurations(count, configuration, rng)]
            observed = scenario.simulate_twins(twins, simulator)
            if observed is None:
                continue
            both = scenario.simulate_twins([do_operation.apply(a) for a in twins], simulator, observed)
            if both is not None:
                return both
        raise CophyError(
            f"no {scenario.name} twins fit this scene in {MAX_TRIES} tries: it was not made with this configuration"
        )

    pairs = [both_of_a_pair() for _ in range(draws // 2)]
    return Hypotheses.drawn([list(both if configuration is None else both[:1]) for both in pairs])


def _two_configurations(count: int, first: int | None, rng: np.random.Generator) -> tuple[int, int]:
    """Two different configurations, of which the first may be given."""
    if first is None:
        first = int(rng.integers(count))
    return first, (first + 1 + int(rng.integers(count - 1))) % count


FIRST_SHARES = (0.2, 0.3, 0.5)  # of AB's frames, which are compared before all of them
MAX_LOG_RATIO = 30.0  # to the most likely one; what is behind by more after the first frames is given up
NUM_GROUPED = 2  # for so many of these shares, one configuration stands for all that hardly differ from it
MAX_GROUP_LOG_RATIO = (
    4 * MAX_LOG_RATIO
)  # it is given up where it is behind by more; of the others some may be more likely
NEGLIGIBLE_LOG_RATIO = float(np.log(100))  # to the most likely one; what is behind by more does not change a mean


@dataclass(frozen=True)
class Explanation:
    """A configuration that may explain AB.

    scene: A under the configuration, with the initial velocities that fit it best. log_probability: not normalised.
    """

    scene: Scene
    log_probability: float


class ConfigurationSearch:
    """Compares AB with simulations under configurations.

    AB is compared with ever more of its frames. A configuration that the first ones speak against is not simulated further.

    Args:
        scenario: whose configurations they are.
        at_rest: A without velocities; its confounders do not matter.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        prior: (configuration,) probabilities.
        noise: standard deviation of every observed coordinate, metres.
        with_velocities: from A under some confounders to A as it must have moved under these.
        simulator: AB is simulated with it.
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
        """Groups of configurations. Whether and where towers topple is up to masses and gravity; friction shows later."""
        groups = dict[Any, list[int]]()
        for configuration in configurations:
            truth = self.scenario.confounders.decode(configuration, len(self.at_rest.objects))
            key = configuration if self.scenario.statics is None else (truth.mass, truth.gravity_xy)
            groups.setdefault(key, []).append(configuration)
        return list(groups.values())

    def enumerated(self, groups: list[list[int]]) -> list[Explanation]:
        """The posterior over all these configurations.

        Args:
            groups: those that hardly differ at first. One stands for all in the first frames, and in all frames of a tower that stands.
        """
        group_of, stands = {group[0]: group for group in groups}, self._tower_stands()
        kept = list(group_of)
        for num_frames in self._lengths if stands else self._lengths[:NUM_GROUPED]:
            tried = self._tried(kept, num_frames)
            kept = self._within(tried, MAX_GROUP_LOG_RATIO)
        kept = [configuration for first in kept for configuration in group_of[first]]
        if stands:
            return self._explanations({c: tried[first] for first in tried for c in group_of[first]})
        for num_frames in self._lengths[NUM_GROUPED - 1 :]:
            tried = self._tried(kept, num_frames)
            kept = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tower_stands(self) -> bool:
        """Whether AB is that of a tower which does not fall."""
        statics = self.scenario.statics
        moved = np.linalg.norm(self.observed - self.observed[0], axis=-1).max()
        return statics is not None and bool(moved < statics.fallen_distance)

    def searched(self, start: Iterable[int], max_configurations: int) -> list[Explanation]:
        """The posterior over the configurations that a search comes across.

        Args:
            start: where it starts.
            max_configurations: how many are tried, over all numbers of frames.
        """
        kept, at_once = list(start), -(-max_configurations // len(self._lengths))
        for num_frames in self._lengths:
            tried = self._tried(kept[:at_once], num_frames)
            self._climb(tried, num_frames, at_once)
            kept = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tried(self, configurations: Iterable[int], num_frames: int) -> dict[int, float]:
        return {c: self._log_probability(c, num_frames) for c in configurations}

    def _climb(self, tried: dict[int, float], num_frames: int, max_configurations: int) -> None:
        """Try the neighbours of the most likely ones, best first.

        It ends where the best explains AB and the neighbours of all that are nearly as likely were tried.
        """
        expanded = set[int]()
        while len(tried) < max_configurations:
            left = [c for c in tried if c not in expanded]
            chosen = max(left, key=tried.__getitem__, default=None)
            least = max(tried.values()) - NEGLIGIBLE_LOG_RATIO
            if chosen is None or (self._explained(tried) and tried[chosen] < least):
                return
            expanded.add(chosen)
            for near in self.scenario.confounders.neighbours(chosen, len(self.at_rest.objects)):
                if near not in tried and self.prior[near] > 0:
                    tried[near] = self._log_probability(near, num_frames)

    def _explained(self, tried: dict[int, float]) -> bool:
        """Whether the best explains AB so well that none can be far more likely."""
        return max(tried.values()) >= float(np.log(self.prior.max())) - NEGLIGIBLE_LOG_RATIO

    def _within(self, tried: dict[int, float], log_ratio: float) -> list[int]:
        """Those near the most likely one, which comes first."""
        least = max(tried.values()) - log_ratio
        return [c for c in sorted(tried, key=tried.__getitem__, reverse=True) if tried[c] >= least]

    def _explanations(self, tried: dict[int, float]) -> list[Explanation]:
        return [Explanation(self._moving(c), tried[c]) for c in self._within(tried, NEGLIGIBLE_LOG_RATIO)]

    def _moving(self, configuration: int) -> Scene:
        """A under a configuration, with the initial velocities that fit it best."""
        if configuration not in self._scene:
            self._scene[configuration] = self.with_velocities(
                self.scenario.with_configuration(configuration, self.at_rest)
            )
        return self._scene[configuration]

    def _log_probability(self, configuration: int, num_frames: int) -> float:
        """Log of prior × likelihood of the first frames; errors of all objects, frames and coordinates are independent."""
        clock = replace(self.scenario.clock, num_frames=num_frames)
        simulated = self.simulator.simulate(
            self._moving(configuration), solver=self.scenario.solver, clock=clock, num_slots=self.scenario.num_slots
        )
        frames = simulated.positions[:: clock.states_per_frame]
        squared = np.square(frames - self.observed[:num_frames])[:, simulated.presence].sum()
        return float(np.log(self.prior[configuration]) - squared / (2 * self.noise**2))
