"""The fit of initial velocities, which starts from the true ones."""

import numpy as np
import pytest

from cophy.oracles.priors import velocity_inference
from cophy.scenario import Body, Scene, Shape, Simulator
from cophy.scenario.physics import make_floor


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
