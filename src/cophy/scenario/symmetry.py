"""Symmetries of the plane that a scenario's physics, surroundings and distributions may have."""

import numpy as np

MIRROR_Y = np.diag([1, -1])
TURNS = 64  # ours: by 5.6° each; a multiple of 4, so that the symmetries of a square are among them
QUARTER_TURN = np.array([[0, -1], [1, 0]])


def disc(turns: int) -> np.ndarray:
    """(2 · turns, 2, 2) rotations by all multiples of 360° / turns, each without and with a reflection."""
    angles = 2 * np.pi * np.arange(turns) / turns
    cos, sin = np.cos(angles), np.sin(angles)
    rotations = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    return np.concatenate([rotations, rotations @ MIRROR_Y])


def square() -> np.ndarray:
    """(8, 2, 2) the rotations and reflections of a square."""
    turns = [np.linalg.matrix_power(QUARTER_TURN, n) for n in range(4)]
    return np.stack([*turns, *(turn @ MIRROR_Y for turn in turns)])
