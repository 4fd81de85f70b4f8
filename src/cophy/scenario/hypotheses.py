"""What D could be, for the two oracles: simulated under confounders and initial velocities that are drawn or inferred, never
read from the answer.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from cophy.scenario.do_operations import DoOperation
from cophy.scenario.physics import Simulator
from cophy.scenario.scenario import Scenario
from cophy.scenario.scene import Scene, Trajectory

ENOUGH = 4.0  # draws that explain AB; with fewer, neighbours of the best are tried too
ROUNDS, BEST = 4, 3  # how often, and of how many
NEGLIGIBLE = 0.01  # of the largest weight


@dataclass(frozen=True)
class Hypothesis:
    """A D that could be, and how likely it is (not normalised)."""

    counterfactual: Trajectory
    weight: float


def without_observation(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    *,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Hypothesis]:
    """D of `draws` experiments that the generator could have made of this A and C, strata and twins included."""
    drawn = scenario.redraw(at_rest(scene), do_operation, draws, rng, simulator)
    return [Hypothesis(trajectory, 1.0) for trajectory in drawn]


def with_observation(
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
    """D under the configurations that explain AB: the posterior over those tried.

    observed: (T, K, 3) positions of AB at the frame rate, metres; the first two frames also tell the initial velocities.
    noise: m; a configuration whose AB is off by d (root mean square) counts exp(-d²/2 noise²) as much as one that fits.
    All configurations are tried where there are no more than `draws`, else as many drawn from the prior; where few of these
    explain AB, their best ones' neighbours are tried next.
    """
    scene, prior = at_rest(scene), scenario.prior(scene, do_operation)
    enumerated = len(prior) <= draws
    drawn = np.arange(len(prior)) if enumerated else rng.choice(len(prior), draws, p=prior)
    launch = scenario.launcher(scene, observed, rng, simulator)
    tried = _Tried(scenario, scene, observed, noise, launch, simulator)
    tried.add(drawn.tolist())
    weight = {c: prior[c] if enumerated else float((drawn == c).sum()) for c in tried.likelihood}
    explained = enumerated or sum(weight[c] * tried.likelihood[c] for c in weight) >= ENOUGH
    for _ in range(0 if explained else ROUNDS):
        for configuration in sorted(tried.error, key=tried.error.__getitem__)[:BEST]:
            near = scenario.confounders.neighbours(configuration, len(scene.objects))
            tried.add(c for c in near if prior[c] > 0)
        weight = {c: prior[c] for c in tried.error}
    return tried.hypotheses(weight, do_operation)


def at_rest(scene: Scene) -> Scene:
    """The scene without what AB's motion alone tells."""
    for body in scene.objects:
        scene = scene.with_object(replace(body, linear_velocity=(0.0, 0.0, 0.0)))
    return scene


class _Tried:
    """Configurations that AB was simulated under. error: configuration -> mean squared distance from what was seen, m²."""

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        observed: np.ndarray,
        noise: float,
        launch: Callable[[Scene], Scene],
        simulator: Simulator,
    ) -> None:
        self.scenario, self.at_rest, self.observed, self.noise = scenario, scene, observed, noise
        self.launch, self.simulator = launch, simulator
        self.scene: dict[int, Scene] = {}
        self.error: dict[int, float] = {}

    @property
    def likelihood(self) -> dict[int, float]:
        """Of AB, up to a factor; 1 where it is as was seen."""
        return {c: float(np.exp(-error / (2 * self.noise**2))) for c, error in self.error.items()}

    def add(self, configurations: Iterable[int]) -> None:
        """Simulate AB under configurations that were not tried yet."""
        for configuration in configurations:
            if configuration not in self.error:
                scene = self.launch(self.scenario.under(configuration, self.at_rest))
                simulated = self.scenario.simulate(self.simulator, scene)
                frames = simulated.positions[:: self.scenario.clock.states_per_frame]
                distance = np.square(frames - self.observed)[1:, simulated.presence].sum(axis=-1)
                self.scene[configuration], self.error[configuration] = scene, float(distance.mean())

    def hypotheses(self, weight: dict[int, float], do_operation: DoOperation) -> list[Hypothesis]:
        """D under all that are not negligible; relative to the best, so that one is left however badly all explain AB."""
        least = min(self.error.values())
        posterior = {c: w * np.exp((least - self.error[c]) / (2 * self.noise**2)) for c, w in weight.items()}
        limit = NEGLIGIBLE * max(posterior.values())
        return [
            Hypothesis(self.scenario.simulate(self.simulator, do_operation.apply(self.scene[c])), float(p))
            for c, p in posterior.items()
            if p >= limit
        ]
