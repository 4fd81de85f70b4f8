"""CD of other experiments that the search could have made of the same A, C and do-operation."""

from functools import singledispatch

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.oracles.configuration_prior import configuration_prior
from cophy.scenario.oracles.initial_velocities import draw_initial_velocities
from cophy.scenario.oracles.unknown_scenario import unknown_scenario
from cophy.scenario.physics.scene import Scene, Trajectory
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario
from cophy.scenario.search.simulated import SimulatedSearch

MAX_TRIES_PER_DRAW = 200  # of initial velocities and two configurations


@singledispatch
def resample(
    scenario: Scenario,
    scene: Scene,
    do_operation: DoOperation,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Trajectory]:
    """CD of experiments as the search could have made them.

    Args:
        scenario: whose search is meant.
        scene: A at rest; its confounders do not matter.
        do_operation: what makes C of A.
        draws: how many CD.
        rng: confounders and initial velocities are drawn from it.
        simulator: CD are simulated with it.

    Raises:
        CophyError: the oracles do not know the scenario, or its search cannot have made this A.
    """
    raise unknown_scenario(scenario)


@resample.register
def _towers(
    scenario: Blocktower,
    scene: Scene,
    do_operation: DoOperation,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Trajectory]:
    prior = configuration_prior(scenario, scene, do_operation)
    drawn, counts = np.unique(rng.choice(len(prior), draws, p=prior), return_counts=True)
    found = [scenario.simulate(simulator, do_operation.apply(scenario.under(int(c), scene))) for c in drawn]
    return [trajectory for trajectory, count in zip(found, counts, strict=True) for _ in range(count)]


@resample.register
def _simulated(
    scenario: SimulatedSearch,
    scene: Scene,
    do_operation: DoOperation,
    draws: int,
    rng: np.random.Generator,
    simulator: Simulator,
) -> list[Trajectory]:
    """Twins are found as `search` finds them, with A and the do-operation held."""
    count, found = scenario.confounders.num_configurations(len(scene.objects)), list[Trajectory]()
    for _ in range(MAX_TRIES_PER_DRAW * draws):
        if len(found) >= draws:
            return found[:draws]
        moving = scene.with_velocities(draw_initial_velocities(scenario, scene, rng))
        twins = [scenario.under(int(c), moving) for c in rng.choice(count, 2, replace=False)]
        if scenario.different_outcomes(twins, simulator) is not None:
            found += scenario.different_outcomes([do_operation.apply(a) for a in twins], simulator) or ()
    raise CophyError(f"no {scenario.name} twins but its own fit this scene: it was not made with this configuration")
