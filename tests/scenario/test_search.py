"""Search by simulation."""

import numpy as np
import pytest

from cophy.scenario import Simulator
from tests.conftest import SCENARIOS


@pytest.mark.parametrize("name", ["balls", "collision"])
def test_a_do_operation_that_changes_nothing_is_not_kept(name: str, scenario_of, simulator: Simulator) -> None:
    scenario = scenario_of(name)
    twins = scenario.twin_pair(SCENARIOS[name], data_seed=0, pair=0, simulator=simulator)
    scenes, observed = [twin.scene for twin in twins], tuple(twin.observed for twin in twins)
    assert scenario.simulate_twins(scenes, simulator) is not None
    assert scenario.simulate_twins(scenes, simulator, observed) is None


def test_an_object_that_is_removed_does_not_count_as_moved(scenario_of, simulator: Simulator) -> None:
    """The do-operation has to matter to some object that is still there."""
    balls = scenario_of("balls")
    scene = balls.twin_pair(3, data_seed=0, pair=0, simulator=simulator)[0].scene.at_rest()
    removal = balls.sample_do_operation("remove", scene, np.random.default_rng(0))
    observed, counterfactual = (balls.simulate(simulator, start) for start in (scene, removal.apply(scene)))
    assert observed.presence.sum() == counterfactual.presence.sum() + 1
    assert not balls.do_operation_matters(observed, counterfactual)
