"""Rigid bodies: what is simulated, how, and what theory says of it.

scene: bodies, scenes and trajectories.
simulation_settings: the solver's settings, and the clock of a sequence.
simulator: from a scene to a trajectory, with PyBullet.
remembering_simulator: the same, which simulates no scene twice.
surroundings: the floor and walls.
orientation: where a body's own axes point.
statics: whether a tower stands, on paper.
energy: the mechanical energy of a trajectory.
"""
