"""What D could be without AB: CD of experiments that the search could have made of the same A, C and do-operation."""

from functools import singledispatch

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.oracles.configuration_prior import configuration_prior
from cophy.scenario.oracles.hypotheses import Hypotheses
from cophy.scenario.oracles.initial_velocities import draw_initial_velocities
from cophy.scenario.oracles.unknown_scenario import unknown_scenario
from cophy.scenario.physics.scene import Scene, Trajectory
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario
from cophy.scenario.search.simulated import SimulatedSearch

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
        known = scenario.simulate(simulator, do_operation.apply(scenario.under(configuration, scene)))
        return Hypotheses([known], np.ones(1))
    prior = configuration_prior(scenario, scene, do_operation)
    drawn, counts = np.unique(rng.choice(len(prior), draws, p=prior), return_counts=True)
    found = [scenario.simulate(simulator, do_operation.apply(scenario.under(int(c), scene))) for c in drawn]
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
            twins = [scenario.under(c, moving) for c in _two_configurations(count, configuration, rng)]
            observed = scenario.different_outcomes(twins, simulator)
            if observed is None:
                continue
            both = scenario.different_outcomes([do_operation.apply(a) for a in twins], simulator, observed)
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
