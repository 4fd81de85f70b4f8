"""Where a frame's RGB comes from: rendered shards, or clips that others released."""

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from cophy.dataset.shardset import Sharded, ShardSet

Clip = tuple[int, int, np.ndarray]  # experiment of a shard, sequence, RGB (T, R, R, 3) uint8
Reader = Callable[[int, int, int], np.ndarray]  # row of the arrays, sequence, time -> (R, R, 3) uint8


class Pictures(Protocol):
    """Frames of a dataset. name: what its frames are a function of, besides the experiments."""

    @property
    def spec(self) -> Sharded: ...

    @property
    def name(self) -> str: ...

    @property
    def states(self) -> ShardSet:
        """What the frames show."""
        ...

    @property
    def command_for_estimates(self) -> str:
        """The command that de-renders these pictures; it lacks the de-renderer."""
        ...

    def checksums(self) -> dict[str, str] | None:
        """SHA-256 per shard of the pictures, or None where they lie in no shards, or no more."""
        ...

    def checksum_of_states(self, shard: int) -> str:
        """SHA-256 of the states that a shard shows."""
        ...

    def sequences(self, shard: int) -> Iterator[Clip]:
        """The sequences of a shard's experiments, in their order; one without pictures is left out."""
        ...

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads frames of the experiments of these arrays; for one process alone."""
        ...
