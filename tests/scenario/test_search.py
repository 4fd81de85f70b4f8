"""Search by simulation."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.states import States
from cophy.scenario import Simulator
from tests.conftest import SCENARIOS, tiny_spec

SIMULATED = ("balls", "collision")


@pytest.mark.parametrize("name", SIMULATED)
def test_the_do_operation_matters_in_every_experiment(name: str, tiny_data: Path) -> None:
    spec = tiny_spec(name)
    arrays = States(spec, tiny_data).load()
    observed, counterfactual = arrays["states"][:, 0, ..., :3], arrays["states"][:, 1, ..., :3]
    distance = np.linalg.norm(observed - counterfactual, axis=-1).mean(axis=1)
    distance[~arrays["presence"].all(axis=1)] = 0.0
    assert (distance.max(axis=-1) >= spec.scenario.min_effect - 1e-4).all()


@pytest.mark.parametrize("name", SIMULATED)
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
