"""Initial velocities of A's objects, which its picture does not show: drawn as the scenario draws them, or inferred from AB."""

from collections.abc import Callable
from functools import singledispatch

import numpy as np

from cophy.scenario.balls import Balls
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.collision import Collision
from cophy.scenario.oracles.initial_velocity_fit import InitialVelocityFit
from cophy.scenario.oracles.unknown_scenario import unknown_scenario
from cophy.scenario.physics.scene import Scene
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario
from cophy.scenario.search.simulated import SimulatedSearch


@singledispatch
def draw_initial_velocities(scenario: Scenario, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """Initial velocities as the scenario would draw them for objects that lie as in this scene.

    Args:
        scenario: whose objects they are.
        scene: A; its confounders and velocities do not matter.
        rng: they are drawn from it.

    Returns:
        (object, 2) horizontal velocities, m/s.
    """
    raise unknown_scenario(scenario)


@draw_initial_velocities.register
def _of_balls(scenario: Balls, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    return scenario.random_velocities(len(scene.objects), rng)


@draw_initial_velocities.register
def _of_collision(scenario: Collision, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """All start alike, so A tells it."""
    return scenario.initial_velocities(scene)


@singledispatch
def velocity_inference(
    scenario: Scenario, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    """How A moves at t = 0, inferred from AB.

    Args:
        scenario: whose objects they are.
        scene: A with its true velocities, from which a fit may start; its confounders do not matter.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        simulator: fits are simulated with it.

    Returns:
        A function from A under any confounders to A as it must have moved under these.
    """
    raise unknown_scenario(scenario)


@velocity_inference.register
def _at_rest(
    scenario: Blocktower, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    return lambda scene: scene


@velocity_inference.register
def _fitted(
    scenario: SimulatedSearch, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    velocity = np.array([body.linear_velocity[:2] for body in scene.objects])
    return InitialVelocityFit(observed, velocity, solver=scenario.solver, clock=scenario.clock, simulator=simulator)
