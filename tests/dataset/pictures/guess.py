"""A de-renderer that looks at nothing."""

from pathlib import Path

import numpy as np

from tests.dataset.pictures.rendered import RENDER


class Guess:
    """Sees every object at the origin."""

    name, source, render = "guess", Path("guess.ckpt"), RENDER

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(rgb), 4, 3)), np.zeros((len(rgb), 4))
