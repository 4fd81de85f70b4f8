import numpy as np
import pytest

from cophy.scenario import Body, Scene, Shape, Simulator
from cophy.scenario.oracles.initial_velocities import velocity_inference
from cophy.scenario.physics.surroundings import floor


@pytest.mark.parametrize("friction", [0.5, 1.0])
def test_velocities_are_recovered_where_the_wall_is_hit_before_the_second_frame(
    friction: float, scenario_of, simulator: Simulator
) -> None:
    scenario = scenario_of("balls")
    places, velocity = [(3.2, 0.0), (-1.0, -2.0)], [(3.0, 1.0), (4.0, 0.3)]
    balls = [
        Body(Shape.SPHERE, (1.0, 1.0, 1.0), (x, y, 0.5), slot=slot, mass=1.0, friction=friction, restitution=1.0)
        for slot, (x, y) in enumerate(places)
    ]
    still = Scene((floor(), *scenario.walls(), *balls), gravity=(0.0, 0.0, -10.0))
    simulated = scenario.simulate(simulator, still.with_velocities(np.array(velocity)))
    frames = simulated.positions[:: scenario.clock.states_per_frame]
    free = (frames[1, : len(places), :2] - np.array(places)) * scenario.clock.frame_rate_hz
    assert np.abs(free - velocity).max() > 1.0  # the mean velocity would not do
    fit = velocity_inference(scenario, still, frames, np.random.default_rng(0), simulator)
    fitted = np.array([body.linear_velocity[:2] for body in fit(still).objects])
    np.testing.assert_allclose(fitted, velocity, atol=0.01)
