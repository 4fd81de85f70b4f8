from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.states import States, do_operation_of, scene_of
from cophy.oracles.priors import configuration_prior
from cophy.scenario import Blocktower, Scene
from cophy.scenario.statics import Combinations
from cophy.scenario.towers import read_tower
from tests.conftest import tiny_spec


@pytest.fixture
def towers(tiny_data: Path) -> tuple[Blocktower, dict[str, np.ndarray]]:
    spec = tiny_spec("blocktower")
    return spec.scenario, States(spec, tiny_data).load()


def test_half_of_what_the_search_makes_of_a_tower_stands(towers) -> None:
    scenario, arrays = towers
    for row in range(0, 12, 2):
        scene, do_operation = scene_of(arrays, row, scenario), do_operation_of(arrays, row, scenario)
        prior = configuration_prior(scenario, scene, do_operation)
        assert prior.shape == (scenario.confounders.num_configurations(3),)
        assert prior.sum() == pytest.approx(1.0)
        stands = np.array([margin(scenario, do_operation.apply(scene), c) > 0 for c in range(len(prior))])
        assert prior[stands].sum() == pytest.approx(0.5)  # twins have opposite outcomes
        by_friction = prior.reshape(8, 8, 9)  # masses, frictions, gravities
        assert (by_friction == by_friction[:, :1]).all()


def test_the_prior_knows_stored_towers(towers) -> None:
    scenario, arrays = towers
    uniform = scenario.confounders.num_configurations(3)
    gain = [
        np.log(
            uniform
            * configuration_prior(scenario, scene_of(arrays, row, scenario), do_operation_of(arrays, row, scenario))[c]
        )
        for row, c in enumerate(arrays["configuration"])
    ]
    assert np.mean(gain) > 0.5  # nats: what cells, twins and margins tell


@pytest.mark.parametrize("name", ["balls", "collision"])
def test_without_statics_all_configurations_are_as_likely(name: str, scenario_of) -> None:
    scenario = scenario_of(name)
    scene = scenario.sample_scene(0, (0, 1), np.random.default_rng(0))
    do_operation = scenario.sample_do_operation(scenario.do_operations[0], scene, np.random.default_rng(0))
    prior = configuration_prior(scenario, scene, do_operation)
    assert (prior == 1 / scenario.confounders.num_configurations(2)).all()


def margin(scenario: Blocktower, c: Scene, configuration: int) -> float:
    """Of a tower C of at most three blocks."""
    truth = scenario.confounders.decode(configuration, 3)
    load = Combinations(np.array([truth.mass]), np.array([truth.gravity_xy]) / -scenario.gravity_z)
    return float(scenario.statics.margins(*read_tower(c), load)[0, 0])
