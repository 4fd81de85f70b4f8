"""What D could be with AB: the posterior over configurations of confounders. The true ones are never used."""

import numpy as np

from cophy.scenario.do_operations import DoOperation
from cophy.scenario.oracles.configuration_prior import configuration_prior
from cophy.scenario.oracles.configuration_search import ConfigurationSearch
from cophy.scenario.oracles.hypotheses import Hypotheses
from cophy.scenario.oracles.initial_velocities import velocity_inference
from cophy.scenario.physics.scene import Scene, Trajectory
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario


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
