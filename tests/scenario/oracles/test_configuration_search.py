"""The posterior over configurations, against sums over all of them."""

from collections.abc import Callable

import numpy as np
import pytest

from cophy.oracles.posterior import ConfigurationSearch
from cophy.scenario import Scenario, Scene, Simulator

NOISE = 0.05
TEXT = [
    "scenario.confounders.mass=[1,10]",
    "scenario.confounders.friction=[0.5,1]",
    "scenario.confounders.restitution=[1]",
]
RELEASED = [f"scenario.confounders.{name}=[{values}]" for name, values in
            (("mass", "1,2,5"), ("friction", "0.1,0.5,1"), ("restitution", "0.1,0.5,1"))]  # fmt: skip


def rolling(scenario: Scenario) -> Scene:
    """Two balls, one of which rolls into the other."""
    scene = scenario.sample_scene(0, (0, 1), np.random.default_rng(0))
    placed = [(-1.5, 0.0), (0.5, 0.2)]
    for body, (x, y) in zip(scene.objects, placed, strict=True):
        scene = scene.with_object(type(body)(**{**vars(body), "position": (x, y, 0.5)}))
    return scene.with_velocities(np.array([[4.0, 0.0], [0.0, 0.5]]))


@pytest.fixture
def searched(scenario_of, simulator: Simulator) -> Callable[..., tuple[ConfigurationSearch, np.ndarray]]:
    """A search whose AB is that of a configuration; and the squared errors of all configurations, m²."""

    def make(configuration: int, *overrides: str, brute: bool = True) -> tuple[ConfigurationSearch, np.ndarray]:
        scenario = scenario_of("balls", "scenario.clock.num_frames=12", *overrides)
        scene, stride = rolling(scenario), scenario.clock.states_per_frame
        count = scenario.confounders.num_configurations(2)

        def frames(c: int) -> np.ndarray:
            return scenario.simulate(simulator, scenario.with_configuration(c, scene)).positions[::stride]

        observed = frames(configuration)
        search = ConfigurationSearch(
            scenario,
            scene,
            observed,
            np.full(count, 1 / count),
            noise=NOISE,
            with_velocities=lambda moving: moving,
            simulator=simulator,
        )
        squared = [np.square(frames(c) - observed)[:, :2].sum() for c in range(count if brute else 0)]
        return search, np.array(squared)

    return make


def test_the_likelihood_is_that_of_independent_errors(searched) -> None:
    search, squared = searched(5, *TEXT)
    found = {each.log_probability for each in search.enumerated(search.alike_at_first(range(16)))}
    expected = -np.log(16) - squared / (2 * NOISE**2)
    likely = expected[expected > expected.max() - np.log(100)]
    np.testing.assert_allclose(sorted(found), sorted(set(likely.tolist())), atol=1e-9)


def test_what_early_frames_rule_out_would_not_have_mattered(searched, simulator: Simulator) -> None:
    spent = 0
    for configuration in range(0, 16, 5):
        search, squared = searched(configuration, *TEXT)
        posterior = np.exp(-squared / (2 * NOISE**2))
        before = simulator.num_simulations
        found = search.enumerated(search.alike_at_first(range(16)))
        assert len(found) == (posterior > 0.01 * posterior.max()).sum()
        spent += simulator.num_simulations - before
    assert spent < 4 * (4 * 16)  # not all are compared with all frames: four AB, four lengths


@pytest.mark.parametrize("configuration", [100, 444, 700])
def test_a_search_over_many_finds_what_explains_ab(configuration: int, searched, simulator: Simulator) -> None:
    search, _ = searched(configuration, *RELEASED, brute=False)
    before = simulator.num_simulations
    found = search.searched(np.random.default_rng(0).choice(729, 12).tolist(), 300)
    coordinates = 3 * 2 * 11  # each of which may be off by the noise
    assert max(each.log_probability for each in found) + np.log(729) > -coordinates / 2
    assert simulator.num_simulations - before <= 3 * (300 // 3 + 12)


def test_what_is_impossible_is_not_tried(searched) -> None:
    search, _ = searched(5, *TEXT)
    search.prior[:] = 0.0
    search.prior[[3, 5]] = 0.5
    found = search.searched([3], 60)
    assert len(found) == 0 or all(each.log_probability <= np.log(0.5) for each in found)
