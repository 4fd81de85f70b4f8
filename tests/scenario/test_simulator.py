"""Simulation: Bullet against closed forms, byte-equal repetitions, and the cache."""

import sys
from dataclasses import replace

import numpy as np
import pybullet
import pytest

from cophy.errors import CophyError
from cophy.scenario import Body, Clock, Scene, Shape, Simulator, Solver, Trajectory
from cophy.scenario import simulator as simulator_module
from cophy.scenario.physics import make_floor, make_walls
from cophy.scenario.simulator import CachingSimulator
from tests.commands import python

CLOCK = Clock(num_frames=30, frame_rate_hz=5, state_rate_hz=20)
IMPACTS = Solver(step_rate_hz=240, iterations=50, elastic_impacts=True)  # as balls and collision
TOWERS = Solver(step_rate_hz=240, iterations=100, elastic_impacts=False)  # as blocktower
G = 10.0


def sphere(slot: int, x: float, *, z: float = 0.5, speed: float = 0.0, **kwargs: float) -> Body:
    values = {"mass": 1.0, "friction": 0.0, "restitution": 1.0} | kwargs
    return Body(Shape.SPHERE, (1, 1, 1), (x, 0.0, z), slot, linear_velocity=(speed, 0.0, 0.0), **values)


def run(simulator: Simulator, *bodies: Body, gravity: float = -G, solver: Solver = IMPACTS) -> Trajectory:
    scene = Scene(bodies, gravity=(0.0, 0.0, gravity))
    return simulator.simulate(scene, solver=solver, clock=CLOCK, num_slots=3)


def test_a_dropped_ball_follows_free_fall(simulator: Simulator) -> None:
    falling = run(simulator, sphere(0, 0.0, z=1000.0)).states[:, 0]
    time = np.arange(CLOCK.num_states) / CLOCK.state_rate_hz
    # semi-implicit Euler falls g·t·dt/2 further than g·t²/2
    np.testing.assert_allclose(1000.0 - falling[:, 2], G * time**2 / 2, rtol=1e-3, atol=G * time[-1] / 240 / 2 + 1e-6)
    np.testing.assert_allclose(falling[:, 9], -G * time, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("first", "second"), [(1.0, 1.0), (1.0, 10.0), (10.0, 1.0)])
@pytest.mark.parametrize("gap", [1.0, 1.003, 1.007])  # wherever between two steps the impact falls
def test_head_on_elastic_impacts_conserve_momentum_and_energy(
    simulator: Simulator, first: float, second: float, gap: float
) -> None:
    speed = 3.0
    bodies = (sphere(0, -1.0 - gap, z=50.0, speed=speed, mass=first), sphere(1, 0.0, z=50.0, mass=second))
    after = run(simulator, *bodies, gravity=0.0).states[-1, :2, 7]
    expected = [(first - second) / (first + second) * speed, 2 * first / (first + second) * speed]
    np.testing.assert_allclose(after, expected, atol=1e-6)


@pytest.mark.parametrize("solver", [TOWERS, IMPACTS])
@pytest.mark.parametrize("friction", [0.25, 0.5, 1.0])
def test_a_slab_slides_v_squared_over_two_mu_g(simulator: Simulator, friction: float, solver: Solver) -> None:
    speed = 4.0  # a slab, since a cube with friction 1 is about to topple
    slab = Body(Shape.BOX, (1, 1, 0.2), (0, 0, 0.1), 0, 1.0, friction, linear_velocity=(speed, 0.0, 0.0))
    distance = run(simulator, make_floor(), slab, solver=solver).states[-1, 0, 0]
    assert distance == pytest.approx(speed**2 / (2 * friction * G), rel=0.015)


@pytest.mark.parametrize("friction", [0.5, 1.0])
@pytest.mark.parametrize("mass", [1.0, 10.0])
def test_a_sliding_sphere_ends_rolling_at_five_sevenths_of_its_speed(
    simulator: Simulator, friction: float, mass: float
) -> None:
    ball = sphere(0, 0.0, speed=4.0, friction=friction, mass=mass, restitution=0.0)
    after = run(simulator, make_floor(), ball).states[-1, 0]
    assert after[7] == pytest.approx(4.0 * 5 / 7, rel=1e-3)
    assert after[11] == pytest.approx(after[7] / 0.5, rel=1e-3)  # rolls without slipping


def test_a_lying_cylinder_ends_rolling_at_two_thirds_of_its_speed(simulator: Simulator) -> None:
    half = float(np.sqrt(0.5))  # a quarter turn about x lays the axis along y
    rolling = Body(
        Shape.CYLINDER,
        (1, 1, 1),
        (0, 0, 0.5),
        0,
        1.0,
        0.5,
        0.0,
        (half, 0.0, 0.0, half),
        linear_velocity=(4.0, 0.0, 0.0),
    )
    after = run(simulator, make_floor(), rolling).states[-1, 0]
    assert after[7] == pytest.approx(4.0 * 2 / 3, rel=2e-3)
    assert abs(after[1]) < 0.05


def test_a_standing_cylinder_slides_a_little_short(simulator: Simulator) -> None:
    """It slides 6 % less than v²/(2μg)."""
    sliding = Body(Shape.CYLINDER, (1, 1, 1), (0, 0, 0.5), 0, 1.0, 0.5, linear_velocity=(4.0, 0.0, 0.0))
    distance = run(simulator, make_floor(), sliding).states[-1, 0, 0]
    assert distance == pytest.approx(4.0**2 / (2 * 0.5 * G), rel=0.08)


def test_a_ball_between_elastic_walls_keeps_its_speed(simulator: Simulator) -> None:
    states = run(simulator, *make_walls(2.0, 2.0), sphere(0, 0.3, speed=5.0), gravity=0.0).states[:, 0]
    assert (np.diff(np.sign(states[:, 7])) != 0).sum() >= 5
    np.testing.assert_allclose(np.abs(states[:, 7]), 5.0, rtol=1e-6)
    assert np.abs(states[:, 0]).max() <= 1.5 + 5.0 / IMPACTS.step_rate_hz  # a wall is felt one step after its touch


def test_the_balls_scenario_is_elastic_among_balls_and_walls(scenario_of) -> None:
    assert scenario_of("balls").confounders.restitution == [1]


def test_the_same_scene_gives_the_same_bytes_whatever_was_simulated_before(simulator: Simulator) -> None:
    ball = sphere(0, -2.0, speed=4.0, friction=0.5, restitution=0.5)
    cylinder = Body(Shape.CYLINDER, (1, 1, 1), (0.1, 0.1, 0.5), 1, mass=10.0, friction=0.5, restitution=0.5)
    other = (make_floor(), *make_walls(3.0, 2.0), replace(ball, slot=2, position=(0.0, 1.0, 2.0)))
    first = run(simulator, make_floor(), ball, cylinder).states.tobytes()
    run(simulator, *other, solver=Solver(480, 20, False))
    assert run(simulator, make_floor(), ball, cylinder).states.tobytes() == first
    with Simulator() as fresh:
        assert run(fresh, make_floor(), ball, cylinder).states.tobytes() == first


@pytest.mark.parametrize(("step_rate_hz", "steps_at_once"), [(240, 4), (180, 1), (640, 32), (260, 1)])
def test_several_steps_in_a_call_are_the_bytes_of_single_steps(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch, step_rate_hz: int, steps_at_once: int
) -> None:
    solver = Solver(step_rate_hz, 50, elastic_impacts=True)
    bodies = (make_floor(), *make_walls(3.0, 2.0), sphere(0, -2.0, speed=7.0), sphere(1, 0.3, speed=1.0, friction=0.5))
    step, calls = pybullet.stepSimulation, list[int]()
    monkeypatch.setattr(pybullet, "stepSimulation", lambda client: (calls.append(1), step(client)))
    whole = run(simulator, *bodies, solver=solver).states
    assert len(calls) * steps_at_once == (CLOCK.num_states - 1) * step_rate_hz // CLOCK.state_rate_hz
    every_step = Clock(CLOCK.num_frames, CLOCK.frame_rate_hz, step_rate_hz)  # a state after each step: no two in a call
    single = simulator.simulate(Scene(bodies, (0.0, 0.0, -G)), solver=solver, clock=every_step, num_slots=3).states
    assert whole.tobytes() == single[:: step_rate_hz // CLOCK.state_rate_hz].tobytes()


def test_two_simulators_do_not_disturb_each_other(simulator: Simulator) -> None:
    with Simulator() as other:
        alone = run(simulator, make_floor(), sphere(0, 0.0, speed=1.0)).states
        run(other, make_floor(), sphere(0, 5.0, speed=9.0))
        np.testing.assert_array_equal(run(simulator, make_floor(), sphere(0, 0.0, speed=1.0)).states, alone)


def test_a_step_rate_that_misses_the_states_is_refused(simulator: Simulator) -> None:
    with pytest.raises(ValueError, match="not a multiple"):
        run(simulator, sphere(0, 0.0), solver=Solver(250, 50, True))


def test_simulating_from_other_velocities_is_simulating_to_a_micrometre(simulator: Simulator) -> None:
    scene = Scene(
        (make_floor(), *make_walls(3.0, 2.0), sphere(0, -1.0, friction=0.5), sphere(1, 1.0, friction=0.5)),
        (0.0, 0.0, -G),
    )
    timing = {"solver": IMPACTS, "frame_rate_hz": CLOCK.frame_rate_hz}
    for velocity in (np.array([[4.0, 0.5], [0.0, 1.0]]), np.array([[1.0, 1.0], [-2.0, 0.0]])):
        whole = simulator.simulate(scene.with_velocities(velocity), solver=IMPACTS, clock=CLOCK, num_slots=2)
        expected = whole.states[:: CLOCK.states_per_frame][1:4][..., [0, 1, 2, 7, 8, 9]]
        for _ in range(2):  # the second time bodies are moved back
            found = simulator.simulate_from(scene, velocity, frames=3, **timing)
            np.testing.assert_allclose(found[..., :3], expected[..., :3], atol=1e-5)


def test_without_pybullet_generation_stops_with_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(CophyError, match=r"PyBullet.*3\.11"):
        Simulator()


def test_pybullet_is_imported_without_its_banner() -> None:
    code = (
        "import sys; from cophy.scenario.simulator import import_pybullet as f; f(); f(); print('!', file=sys.stderr)"
    )
    found = python("-c", code)
    assert (found.stdout, found.stderr) == ("", "!\n")


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
