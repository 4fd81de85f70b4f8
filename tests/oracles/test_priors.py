"""Priors of configurations and initial velocities, and the fit of initial velocities."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.states import States, build_scene, do_operation_of
from cophy.errors import CophyError
from cophy.oracles.posterior import posterior, resample
from cophy.oracles.priors import configuration_prior, velocity_inference
from cophy.scenario import Balls, Blocktower, Body, Scenario, Scene, Shape, Simulator
from cophy.scenario.experiment import Displace
from cophy.scenario.physics import make_floor
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
        scene, do_operation = build_scene(arrays, row, scenario), do_operation_of(arrays, row, scenario)
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
            * configuration_prior(scenario, build_scene(arrays, row, scenario), do_operation_of(arrays, row, scenario))[
                c
            ]
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
    """For a tower C of at most three blocks."""
    truth = scenario.confounders.decode(configuration, 3)
    load = Combinations(np.array([truth.mass]), np.array([truth.gravity_xy]) / -scenario.gravity_z)
    return float(scenario.statics.margins(*read_tower(c), load)[0, 0])


def scene_of_two(scenario, friction: float) -> Scene:
    """Two balls, of which the first hits a wall within the first 0.2 s."""
    balls = [
        Body(Shape.SPHERE, (1.0, 1.0, 1.0), (x, y, 0.5), slot=slot, mass=1.0, friction=friction, restitution=1.0)
        for slot, (x, y) in enumerate([(3.2, 0.0), (-1.0, -2.0)])
    ]
    scene = Scene((make_floor(), *scenario.walls(), *balls), gravity=(0.0, 0.0, -10.0))
    return scene.with_velocities(np.array([(3.0, 1.0), (4.0, 0.3)]))


def velocities(scene: Scene) -> np.ndarray:
    return np.array([body.linear_velocity[:2] for body in scene.objects])


@pytest.mark.parametrize("friction", [0.5, 1.0])
def test_the_truth_fits_and_other_confounders_are_fitted_to_the_second_frame(
    friction: float, scenario_of, simulator: Simulator
) -> None:
    scenario, stride = scenario_of("balls"), scenario_of("balls").clock.states_per_frame
    true, other = scene_of_two(scenario, friction), scene_of_two(scenario, 0.3)
    frames = scenario.simulate(simulator, true).positions[::stride]
    fit = velocity_inference(scenario, true, frames, simulator)
    np.testing.assert_array_equal(velocities(fit(true.at_rest())), velocities(true))
    fitted = fit(other.at_rest())
    assert (
        np.abs(velocities(fitted) - velocities(true))[1].max() > 0.02
    )  # the free ball slides less, so it is thrown slower
    found = scenario.simulate(simulator, fitted).positions[stride]
    np.testing.assert_allclose(found[1, :2], frames[1, 1, :2], atol=0.005)
    np.testing.assert_allclose(found[0, :2], frames[1, 0, :2], atol=0.05)  # a wall between


class Marbles(Balls):
    """A scenario of a user."""


def test_a_scenario_of_the_user_that_is_found_by_simulation_has_a_prior(scenario_of: Callable[..., Scenario]) -> None:
    own = object.__new__(Marbles)
    vars(own).update(vars(scenario_of("balls")), name="marbles")
    scene = own.sample_scene(0, (0, 1), np.random.default_rng(0))
    prior = configuration_prior(own, scene, Displace("displace", 0, (0.1, 0.0, 0.0)))
    np.testing.assert_allclose(prior, 1 / own.confounders.num_configurations(2))
    drawn = own.sample_velocities(scene, np.random.default_rng(1))
    assert drawn.shape == (2, 2)
    assert own.speed[0] <= np.linalg.norm(drawn, axis=1).min() <= np.linalg.norm(drawn, axis=1).max() <= own.speed[1]


class Pendulums(Scenario):
    """A scenario of another kind."""

    known_do_operations = cells = symmetries = object_size_m = search = None  # type: ignore[assignment]


def test_oracles_refuse_a_scenario_that_they_do_not_know_in_one_line(
    scenario_of: Callable[..., Scenario], simulator: Simulator
) -> None:
    known = scenario_of("balls")
    scene, displaced = known.sample_scene(0, (0, 1), np.random.default_rng(0)), Displace("displace", 0, (0.1, 0.0, 0.0))
    unknown = object.__new__(Pendulums)
    vars(unknown).update(vars(known), name="new")
    arguments = {"draws": 2, "rng": np.random.default_rng(0), "simulator": simulator}
    with pytest.raises(CophyError, match=r"^the oracles do not know scenario=new: .*Pendulums[^\n]*$"):
        resample(unknown, scene, displaced, **arguments)
    with pytest.raises(CophyError, match="scenario=new"):
        posterior(unknown, scene, displaced, np.zeros((30, 9, 3)), max_configurations=2, noise=0.05, **arguments)
