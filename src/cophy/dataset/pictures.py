"""Where a frame's RGB comes from: rendered shards, or clips that others released."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from cophy.dataset.shardset import Sharded

Reader = Callable[[int, int, int], np.ndarray]  # row of the arrays, sequence, time -> (R, R, 3) uint8


class Pictures(Protocol):
    """Frames of a dataset. name: what its frames are a function of, besides the experiments."""

    @property
    def spec(self) -> Sharded: ...

    @property
    def name(self) -> str: ...

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads frames of the experiments of these arrays; for one process alone."""
        ...
