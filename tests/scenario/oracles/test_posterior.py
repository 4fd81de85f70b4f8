"""What D could be with AB, where the truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from cophy.oracles.posterior import Hypotheses, posterior, resample
from cophy.scenario import Experiment, Scenario, Simulator
from cophy.scenario.simulator import CachingSimulator

ASKED = {"draws": 4, "max_configurations": 300, "noise": 0.05}


def with_ab(scenario: Scenario, twin: Experiment, simulator: Simulator) -> Hypotheses:
    seen = twin.observed.positions[:: scenario.clock.states_per_frame]
    rng = np.random.default_rng(0)
    return posterior(scenario, twin.scene, twin.do_operation, seen, **ASKED, rng=rng, simulator=simulator)


@pytest.mark.parametrize(("name", "num_objects"), [("blocktower", 3), ("balls", 2), ("collision", 2)])
def test_ab_narrows_down_what_d_could_be(name: str, num_objects: int, scenario_of) -> None:
    scenario = scenario_of(name)
    with CachingSimulator() as simulator:
        twins = scenario.twin_pair(num_objects, data_seed=0, pair=0, simulator=simulator)
        asked = {"draws": 4, "rng": np.random.default_rng(0), "simulator": simulator}
        without = resample(scenario, twins[0].scene, twins[0].do_operation, **asked)
        errors = [
            [error(hypotheses, twin) for hypotheses in (without, with_ab(scenario, twin, simulator))] for twin in twins
        ]
    of_without, of_with = np.mean(errors, axis=0)
    assert of_with < 0.2 * of_without


def error(hypotheses: Hypotheses, twin: Experiment) -> float:
    """Mean squared error of the mean of D, m²."""
    difference = hypotheses.mean(hypotheses.states[..., :3]) - twin.counterfactual.positions
    return float(np.square(difference)[:, twin.counterfactual.presence].mean())


def test_the_true_configuration_explains_ab(scenario_of) -> None:
    scenario = scenario_of("collision", "confounders=text")
    for pair in (0, 1):
        with CachingSimulator() as simulator:
            for twin in scenario.twin_pair(2, data_seed=0, pair=pair, simulator=simulator):
                hypotheses = with_ab(scenario, twin, simulator)
                assert hypotheses.draw is None
                found = [np.array_equal(d.states, twin.counterfactual.states) for d in hypotheses.counterfactuals]
                assert hypotheses.weight[found].sum() >= 1 / 16


def test_confounders_are_not_looked_at(scenario_of) -> None:
    scenario = scenario_of("collision", "confounders=text")
    with CachingSimulator() as simulator:
        twin, _ = scenario.twin_pair(2, data_seed=0, pair=0, simulator=simulator)
        disguised = replace(twin, scene=scenario.with_configuration(0, twin.scene), configuration=0)
        first, second = (with_ab(scenario, each, simulator) for each in (twin, disguised))
    assert np.array_equal(first.states, second.states)
    assert np.array_equal(first.weight, second.weight)
