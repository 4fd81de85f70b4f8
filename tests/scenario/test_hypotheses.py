"""What the oracles take for possible: known cases by hand, and inference where the truth is known."""

import numpy as np
import pytest

from cophy.dataset.replay import do_operation_of, scene_of
from cophy.scenario import Simulator
from cophy.scenario.hypotheses import at_rest, with_observation, without_observation
from cophy.scenario.launch import VelocityFit, with_velocities
from cophy.scenario.scene import Body, Scene, Shape
from cophy.scenario.stability import tower_margins
from cophy.scenario.surroundings import floor


def observed(arrays: dict, row: int, stride: int) -> np.ndarray:
    return arrays["states"][row, 0, ::stride, :, :3].astype(np.float64)


def test_neighbours_differ_in_one_value(scenario_of) -> None:
    grid = scenario_of("blocktower").confounders
    near = [grid.decode(c, 3) for c in grid.neighbours(0, 3)]
    assert len(near) == len(set(map(str, near))) == 3 + 3 + 2 + 2  # masses, frictions, gravity x, gravity y
    own = grid.decode(0, 3)
    for other in near:
        values, theirs = ([*c.mass, *c.friction, *c.gravity_xy] for c in (own, other))
        assert sum(a != b for a, b in zip(values, theirs, strict=True)) == 1


def test_half_of_what_the_search_makes_of_a_tower_stands(tiny) -> None:
    spec, arrays = tiny
    scenario = spec.scenario
    if scenario.name != "blocktower":
        pytest.skip("only towers have a prior of their own")
    for row in range(0, 12, 2):
        scene, do_operation = scene_of(arrays, row, scenario), do_operation_of(arrays, row)
        prior = scenario.prior(scene, do_operation)
        assert prior.shape == (scenario.confounders.num_configurations(3),)
        assert prior.sum() == pytest.approx(1.0)
        stands = np.array([margin(scenario, do_operation.apply(scene), c) > 0 for c in range(len(prior))])
        assert prior[stands].sum() == pytest.approx(0.5)  # twins have opposite outcomes
        by_friction = prior.reshape(8, 8, 9)  # masses, frictions, gravities
        assert (by_friction == by_friction[:, :1]).all()


def test_the_prior_knows_stored_towers(tiny, scenario_of) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("only towers have a prior of their own")
    uniform = spec.scenario.confounders.num_configurations(spec.num_objects)
    gain = [
        np.log(uniform * spec.scenario.prior(scene_of(arrays, row, spec.scenario), do_operation_of(arrays, row))[c])
        for row, c in enumerate(arrays["configuration"])
    ]
    assert np.mean(gain) > 0.5  # nats: what strata, twins and margins tell


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
    simulated = scenario.simulate(simulator, with_velocities(still, np.array(velocity)))
    frames = simulated.positions[:: scenario.clock.states_per_frame]
    free = (frames[1, : len(places), :2] - np.array(places)) * scenario.clock.frame_rate_hz
    assert np.abs(free - velocity).max() > 1.0  # the mean velocity would not do
    rng = np.random.default_rng(0)
    fit = VelocityFit(
        frames, lambda: scenario.launch(still, rng), solver=scenario.solver, clock=scenario.clock, simulator=simulator
    )
    launched = np.array([body.linear_velocity[:2] for body in fit(still).objects])
    np.testing.assert_allclose(launched, velocity, atol=0.01)


def test_ab_narrows_down_what_d_could_be(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    error = {"without": [], "with": []}
    for row in range(4):
        scene, do_operation = scene_of(arrays, row, scenario), do_operation_of(arrays, row)
        asked = {"draws": 6, "rng": np.random.default_rng(row), "simulator": simulator}
        found = {
            "without": without_observation(scenario, scene, do_operation, **asked),
            "with": with_observation(scenario, scene, do_operation, observed(arrays, row, stride), noise=0.05, **asked),
        }
        true, present = arrays["states"][row, 1, ..., :3], arrays["presence"][row, 1]
        for name, hypotheses in found.items():
            weights = [hypothesis.weight for hypothesis in hypotheses]
            mean = np.average([h.counterfactual.positions for h in hypotheses], axis=0, weights=weights)
            error[name].append(np.square(mean - true)[:, present].mean())
        assert len(found["without"]) == 6
    assert np.mean(error["with"]) < 0.5 * np.mean(error["without"])


def test_oracles_do_not_look_at_confounders_or_velocities(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    if spec.scenario.name == "balls":
        pytest.skip("as collision, and slower")
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    scene, do_operation = scene_of(arrays, 0, scenario), do_operation_of(arrays, 0)
    disguised = scenario.under(0, at_rest(scene))

    def answers(of: Scene) -> list[float]:
        asked = {"draws": 4, "simulator": simulator}
        found = without_observation(scenario, of, do_operation, rng=np.random.default_rng(0), **asked)
        seen = observed(arrays, 0, stride)
        found += with_observation(scenario, of, do_operation, seen, noise=0.05, rng=np.random.default_rng(0), **asked)
        return [float(h.counterfactual.positions.sum()) for h in found]

    assert answers(scene) == answers(disguised)


def margin(scenario, c: Scene, configuration: int) -> float:
    """Of a tower C of at most three blocks."""
    truth, levels = scenario.confounders.decode(configuration, 3), len(c.objects)
    xy = np.array([[block.position[:2] for block in c.objects]])
    yaw = np.array([[2 * np.arctan2(block.quaternion_xyzw[2], block.quaternion_xyzw[3]) for block in c.objects]])
    tilt = np.array([truth.gravity_xy]) / -scenario.gravity_z
    return float(tower_margins(xy, yaw, np.array([truth.mass[:levels]]), tilt)[0, 0])
