"""What the oracles take for possible: known cases by hand, and inference where the truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from cophy.dataset.replay import do_operation_of, scene_of
from cophy.scenario import Simulator
from cophy.scenario.do_operations import Displace, Remove
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


@pytest.mark.parametrize("do_operation", [Displace(1, (0.3, 0.0, 0.0)), Displace(0, (0.0, -0.2, 0.0)), Remove(2)])
def test_half_of_what_the_search_makes_of_a_tower_stands(do_operation, scenario_of) -> None:
    scenario = scenario_of("blocktower")
    scene = tower(scenario, [(0.0, 0.0), (0.3, 0.1), (0.1, 0.25)])
    prior = scenario.prior(scene, do_operation)
    assert prior.shape == (scenario.confounders.num_configurations(3),)
    assert prior.sum() == pytest.approx(1.0)
    stands = np.array([margin(scenario, scene, do_operation, c) > 0 for c in range(len(prior))])
    assert 0.0 < stands.mean() < 1.0
    assert prior[stands].sum() == pytest.approx(0.5)  # twins have opposite outcomes
    friction = prior.reshape(8, 8, 9)  # masses, frictions, gravities
    assert (friction == friction[:, :1]).all()


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
def test_velocities_are_recovered_after_a_bounce_off_the_wall_and_another_ball(
    friction: float, scenario_of, simulator: Simulator
) -> None:
    scenario = scenario_of("balls")
    ball = Body(Shape.SPHERE, (1.0, 1.0, 1.0), (3.3, 0.0, 0.5), slot=0, mass=1.0, friction=friction)
    others = [replace(ball, slot=s, position=(x, -1.5, 0.5)) for s, x in ((1, -1.0), (2, 0.2))]
    still = Scene((*surroundings(scenario), ball, *others), gravity=(0.0, 0.0, -10.0))
    velocity = np.array([[3.0, 1.0], [4.0, 0.3], [-2.0, 0.0]])  # the first into the wall, the others into each other
    simulated = scenario.simulate(simulator, with_velocities(still, velocity))
    frames = simulated.positions[:: scenario.clock.states_per_frame]
    rng = np.random.default_rng(0)
    fit = VelocityFit(
        frames, lambda: scenario.launch(still, rng), solver=scenario.solver, clock=scenario.clock, simulator=simulator
    )
    launched = np.array([body.linear_velocity[:2] for body in fit(still).objects])
    np.testing.assert_allclose(launched, velocity, atol=1e-3)


def test_ab_narrows_down_what_d_could_be(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    error = {"without": [], "with": []}
    for row in range(6):
        scene, do_operation = scene_of(arrays, row, scenario), do_operation_of(arrays, row)
        asked = {"draws": 12, "rng": np.random.default_rng(row), "simulator": simulator}
        found = {
            "without": without_observation(scenario, scene, do_operation, **asked),
            "with": with_observation(scenario, scene, do_operation, observed(arrays, row, stride), noise=0.05, **asked),
        }
        true, present = arrays["states"][row, 1, ..., :3], arrays["presence"][row, 1]
        for name, hypotheses in found.items():
            weights = [hypothesis.weight for hypothesis in hypotheses]
            mean = np.average([h.counterfactual.positions for h in hypotheses], axis=0, weights=weights)
            error[name].append(np.square(mean - true)[:, present].mean())
        assert len(found["without"]) == 12
    assert np.mean(error["with"]) < 0.5 * np.mean(error["without"])


def test_oracles_do_not_look_at_confounders_or_velocities(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    scene, do_operation = scene_of(arrays, 0, scenario), do_operation_of(arrays, 0)
    disguised = scenario.under(0, at_rest(scene))
    for of in (scene, disguised):
        assert of.objects[0].position == scene.objects[0].position

    def answers(of: Scene) -> list[float]:
        asked = {"draws": 4, "simulator": simulator}
        found = without_observation(scenario, of, do_operation, rng=np.random.default_rng(0), **asked)
        seen = observed(arrays, 0, stride)
        found += with_observation(scenario, of, do_operation, seen, noise=0.05, rng=np.random.default_rng(0), **asked)
        return [float(h.counterfactual.positions.sum()) for h in found]

    assert answers(scene) == answers(disguised)


def tower(scenario, offsets: list[tuple[float, float]]) -> Scene:
    blocks = tuple(
        Body(Shape.BOX, (1.0, 1.0, 1.0), (x, y, level + 0.5), slot=level, mass=1.0)
        for level, (x, y) in enumerate(offsets)
    )
    return Scene(blocks, gravity=(0.0, 0.0, scenario.gravity_z))


def margin(scenario, scene: Scene, do_operation, configuration: int) -> float:
    c = do_operation.apply(scene)
    truth = scenario.confounders.decode(configuration, len(scene.objects))
    masses = np.array([truth.mass[: len(c.objects)]])
    tilt = np.array([truth.gravity_xy]) / -scenario.gravity_z
    xy = np.array([[block.position[:2] for block in c.objects]])
    return float(tower_margins(xy, np.zeros(xy.shape[:2]), masses, tilt)[0, 0])


def surroundings(scenario) -> tuple[Body, ...]:
    return (floor(), *scenario.walls())
