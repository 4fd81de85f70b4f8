"""What AB shows of a tower, on paper, and whether that settles if C stands (paper Sec. 3: AB has to tell the confounders).

A tower that stands shows only that it stands. Of one that falls, AB shows gravity, and the masses of the blocks that fall up to a
common factor. Nothing shows the masses of blocks that stay where they are.
"""

import numpy as np

from cophy.scenario.physics.statics import Combinations


def settled(falls_from: np.ndarray, stands: np.ndarray, combinations: Combinations) -> np.ndarray:
    """Whether all combinations of masses and gravity that AB cannot tell apart agree on if C stands.

    Args:
        falls_from: (tower, combination) of A, see `TowerStatics.falls_from`.
        stands: (tower, combination) bool, of C.
        combinations: of masses and gravity.

    Returns:
        (tower, combination) bool: whether an A that falls so under this combination settles it.
    """
    shown = _shown(combinations)
    group = shown[falls_from, np.arange(falls_from.shape[1])] + shown.size * np.arange(len(falls_from))[:, None]
    size = np.bincount(group.ravel())
    standing = np.bincount(group.ravel(), weights=stands.ravel())
    return np.asarray(((standing == 0) | (standing == size))[group])


def _shown(combinations: Combinations) -> np.ndarray:
    """(level + 1, combination): a number for what AB shows if the tower falls from this level; the last, if it stands."""
    count, num_levels = combinations.mass.shape
    shown = np.zeros((num_levels + 1, count), dtype=np.int64)
    for level in range(num_levels):
        falling = combinations.mass[:, level:]
        seen = np.hstack([falling / falling.max(axis=1, keepdims=True), combinations.tilt])
        shown[level] = 1 + level * count + np.unique(seen, axis=0, return_inverse=True)[1].reshape(-1)
    return shown
