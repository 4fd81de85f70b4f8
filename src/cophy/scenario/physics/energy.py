"""Mechanical energy of a trajectory, against which simulations are judged."""

import numpy as np

from cophy.scenario.physics.orientation import z_axis
from cophy.scenario.physics.scene import Body, Scene, Shape, Trajectory

MIN_START_ENERGY_J = 10.0  # gains of what starts with less, a standing tower for one, are shares of this: 1 kg at 1 m


def energy(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(time,) kinetic and potential energy in J of the scene's objects, above its lowest value."""
    total = np.zeros(len(trajectory.states))
    for body in scene.objects:
        position, quaternion, linear, angular = np.split(trajectory.states[:, body.slot], [3, 7, 10], axis=-1)
        along = (angular * z_axis(quaternion)).sum(axis=-1) ** 2
        across = (angular**2).sum(axis=-1) - along
        about, through = _moments_per_mass(body)
        kinetic = 0.5 * ((linear**2).sum(axis=-1) + about * along + through * across)
        total += body.mass * (kinetic - position @ np.array(scene.gravity))
    return total - total.min()


def largest_gain(scene: Scene, trajectory: Trajectory) -> float:
    """The largest gain from one state to the next, as a share of the energy at the start. Nothing should gain any."""
    joules = energy(scene, trajectory)
    return float(np.diff(joules).max() / max(joules[0], MIN_START_ENERGY_J))


def _moments_per_mass(body: Body) -> tuple[float, float]:
    """Moments of inertia over mass (m²), about the body's z axis and across it; boxes are as wide as deep."""
    width, depth, height = body.size_m
    if body.shape is Shape.BOX:
        return (width**2 + depth**2) / 12, (width**2 + height**2) / 12
    if body.shape is Shape.SPHERE:
        return width**2 / 10, width**2 / 10
    return width**2 / 8, width**2 / 16 + height**2 / 12
