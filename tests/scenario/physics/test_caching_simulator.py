import numpy as np

from cophy.scenario import simulator as simulator_module
from cophy.scenario.simulator import CachingSimulator


def test_a_scene_is_simulated_once_until_the_cache_is_cleared(scenario_of) -> None:
    scenario = scenario_of("collision")
    scene = scenario.with_configuration(0, scenario.sample_scene(0, (0, 1), np.random.default_rng(0)))
    with CachingSimulator() as simulator:
        first = scenario.simulate(simulator, scene)
        assert (
            scenario.simulate(simulator, scenario.with_configuration(0, scene.with_velocities(_velocities(scene))))
            is first
        )
        assert scenario.simulate(simulator, scenario.with_configuration(1, scene)) is not first
        assert simulator.num_simulations == 2
        simulator.clear_cache()
        again = scenario.simulate(simulator, scene)
        assert simulator.num_simulations == 3
        assert np.array_equal(again.states, first.states)


def test_the_oldest_trajectory_is_deleted_when_the_cache_is_full(scenario_of, monkeypatch) -> None:
    scenario = scenario_of("collision")
    scene = scenario.sample_scene(0, (0, 1), np.random.default_rng(0))
    monkeypatch.setattr(simulator_module, "_MAX_CACHED", 2)
    with CachingSimulator() as simulator:
        first, second, third = (
            scenario.simulate(simulator, scenario.with_configuration(each, scene)) for each in (0, 1, 2)
        )
        assert scenario.simulate(simulator, scenario.with_configuration(1, scene)) is second
        assert scenario.simulate(simulator, scenario.with_configuration(2, scene)) is third
        assert scenario.simulate(simulator, scenario.with_configuration(0, scene)) is not first
        assert simulator.num_simulations == 4


def _velocities(scene) -> np.ndarray:
    return np.array([body.linear_velocity[:2] for body in scene.objects])
