"""Simulates possible outcomes D for the two oracles.

Confounders and initial velocities are drawn or inferred. The true ones are never used.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from cophy.scenario.do_operations import DoOperation
from cophy.scenario.oracles.configuration_prior import configuration_prior
from cophy.scenario.oracles.initial_velocities import velocity_inference
from cophy.scenario.oracles.resampling import resample
from cophy.scenario.physics.scene import Scene, Trajectory
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario

MIN_EXPLAINING_DRAWS = 4.0  # of configurations that explain AB; with fewer, neighbours of the best are tried too,
MAX_NEIGHBOUR_ROUNDS = 4  # so often,
NUM_BEST = 3  # and of so many
MIN_RELATIVE_WEIGHT = 0.01  # of the largest weight; what has less is negligible


@dataclass(frozen=True)
class Hypothesis:
    """A possible D, and how likely it is (not normalised)."""

    counterfactual: Trajectory
    weight: float


def feedforward_hypotheses(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    *,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Hypothesis]:
    """Hypotheses about D without AB: CD of experiments that the generator could have made of this A and C.

    They are drawn as the generator draws them, by cell and with twins.

    Args:
        scenario: whose generator is meant.
        scene: A; its confounders and velocities are not looked at.
        do_operation: what makes C of A.
        draws: how many experiments.
        rng: they are drawn from it.
        simulator: D are simulated with it.
    """
    drawn = resample(scenario, scene.at_rest(), do_operation, draws, rng, simulator)
    return [Hypothesis(trajectory, 1.0) for trajectory in drawn]


def counterfactual_hypotheses(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    observed: np.ndarray,
    *,
    draws: int,
    noise: float,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Hypothesis]:
    """Hypotheses about D with AB: the posterior over the configurations that were tried.

    All configurations are tried where there are no more than `draws`. Otherwise `draws` of them are drawn from the prior.
    If few of these explain AB, the neighbours of the best ones are tried next.

    Args:
        scenario: whose generator is meant.
        scene: A; its confounders and velocities are not looked at.
        do_operation: what makes C of A.
        observed: (T, K, 3) positions of AB at the frame rate, metres; the first frames also tell the initial velocities.
        draws: how many configurations.
        noise: metres; a configuration whose AB is off by d (root mean square) counts exp(-d²/2 noise²) as much as one that fits.
        rng: configurations are drawn from it.
        simulator: AB and D are simulated with it.
    """
    scene = scene.at_rest()
    prior = configuration_prior(scenario, scene, do_operation)
    enumerated = len(prior) <= draws
    drawn = np.arange(len(prior)) if enumerated else rng.choice(len(prior), draws, p=prior)
    tried = _Tried(
        scenario, scene, observed, noise, velocity_inference(scenario, scene, observed, rng, simulator), simulator
    )
    tried.add(drawn.tolist())
    weight = {c: prior[c] if enumerated else float((drawn == c).sum()) for c in tried.likelihood}
    explained = enumerated or sum(weight[c] * tried.likelihood[c] for c in weight) >= MIN_EXPLAINING_DRAWS
    for _ in range(0 if explained else MAX_NEIGHBOUR_ROUNDS):
        for configuration in sorted(tried.error, key=tried.error.__getitem__)[:NUM_BEST]:
            near = scenario.confounders.neighbours(configuration, len(scene.objects))
            tried.add(c for c in near if prior[c] > 0)
        weight = {c: prior[c] for c in tried.error}
    return tried.hypotheses(weight, do_operation)


class _Tried:
    """Configurations under which AB was simulated.

    error: configuration -> mean squared distance of the simulated AB from the observed one, m².
    """

    def __init__(
        self,
        scenario: Scenario,
        at_rest: Scene,
        observed: np.ndarray,
        noise: float,
        with_velocities: Callable[[Scene], Scene],
        simulator: Simulator,
    ) -> None:
        self.scenario, self.at_rest, self.observed, self.noise = scenario, at_rest, observed, noise
        self.with_velocities, self.simulator = with_velocities, simulator
        self.scene: dict[int, Scene] = {}
        self.error: dict[int, float] = {}

    @property
    def likelihood(self) -> dict[int, float]:
        """Configuration -> likelihood of AB, up to a factor; 1 where the simulated AB is exactly the observed one."""
        return {c: float(np.exp(-error / (2 * self.noise**2))) for c, error in self.error.items()}

    def add(self, configurations: Iterable[int]) -> None:
        """Simulate AB under configurations that were not tried yet."""
        for configuration in configurations:
            if configuration not in self.error:
                scene = self.with_velocities(self.scenario.under(configuration, self.at_rest))
                simulated = self.scenario.simulate(self.simulator, scene)
                frames = simulated.positions[:: self.scenario.clock.states_per_frame]
                distance = np.square(frames - self.observed)[1:, simulated.presence].sum(axis=-1)
                self.scene[configuration], self.error[configuration] = scene, float(distance.mean())

    def hypotheses(self, weight: dict[int, float], do_operation: DoOperation) -> list[Hypothesis]:
        """Simulates D under every configuration with a noticeable weight.

        Weights are relative to the best configuration, so at least one always remains.
        """
        least = min(self.error.values())
        posterior = {c: w * np.exp((least - self.error[c]) / (2 * self.noise**2)) for c, w in weight.items()}
        limit = MIN_RELATIVE_WEIGHT * max(posterior.values())
        return [
            Hypothesis(self.scenario.simulate(self.simulator, do_operation.apply(self.scene[c])), float(p))
            for c, p in posterior.items()
            if p >= limit
        ]
