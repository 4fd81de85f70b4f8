"""How likely each configuration of confounders is in the data, given A, C and the do-operation."""

from functools import singledispatch

import numpy as np

from cophy.scenario.blocktower import Blocktower
from cophy.scenario.do_operations import DoOperation
from cophy.scenario.oracles.tower_prior import tower_prior
from cophy.scenario.oracles.unknown_scenario import unknown_scenario
from cophy.scenario.physics.scene import Scene
from cophy.scenario.scenario import Scenario
from cophy.scenario.search.simulated import SimulatedSearch
from cophy.scenario.search.towers import tower_of


@singledispatch
def configuration_prior(scenario: Scenario, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    """The prior of the oracles.

    Args:
        scenario: whose data are meant.
        scene: A; its confounders and velocities do not matter.
        do_operation: what makes C of A.

    Returns:
        (configuration,) probabilities.
    """
    raise unknown_scenario(scenario)


@configuration_prior.register
def _of_towers(scenario: Blocktower, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    num_levels = len(scene.objects)
    towers = tower_of(scene), tower_of(do_operation.apply(scene))
    probability = tower_prior(scenario, do_operation.kind, num_levels)(towers)[0]
    return scenario.confounders.spread(probability, num_levels)


@configuration_prior.register
def _uniform(scenario: SimulatedSearch, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    count = scenario.confounders.num_configurations(len(scene.objects))
    return np.full(count, 1 / count)
