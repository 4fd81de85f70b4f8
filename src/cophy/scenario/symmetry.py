"""Symmetries of the plane that a scenario's physics, surroundings and distributions may have."""

import numpy as np

MIRROR_Y = np.diag([1, -1])
QUARTER_TURN = np.array([[0, -1], [1, 0]])


def mirror() -> np.ndarray:
    """(2, 2, 2) leave as it is, or mirror y."""
    return np.stack([np.eye(2, dtype=int), MIRROR_Y])


def square() -> np.ndarray:
    """(8, 2, 2) the rotations and reflections of a square."""
    turns = [np.linalg.matrix_power(QUARTER_TURN, n) for n in range(4)]
    return np.stack([*turns, *(turn @ MIRROR_Y for turn in turns)])
