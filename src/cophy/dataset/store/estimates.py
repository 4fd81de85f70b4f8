"""What a de-renderer sees in every frame of a dataset, in shards beside the states that the pictures show."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cophy.dataset import generation
from cophy.dataset.store.experiment_set import FrameSource
from cophy.dataset.store.hdf5_arrays import Field, Fields, creating
from cophy.dataset.store.shardset import ShardSet
from cophy.scenario.rendering.frames import RenderSettings


class Sees(Protocol):
    """A trained de-renderer. name: of its checkpoint, by content. source: where that lies. render: the pictures it knows."""

    name: str
    source: Path
    render: RenderSettings

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""
        ...


class Estimates(ShardSet):
    """Estimates of all frames of AB (sequence 0) and CD (1).

    position: (experiment, 2, T, slot, 3) float32, metres. presence_logit: (experiment, 2, T, slot) float32. Both are zero
    where there are no pictures.
    """

    def __init__(self, frames: FrameSource, derenderer: Sees) -> None:
        self.frames, self.derenderer, states = frames, derenderer, frames.states
        super().__init__(
            states.spec,
            states.directory / f"derendered-{derenderer.name}",
            title=f"de-rendered {states.title}",
            command=f"{states.command_for('derender')} derenderer={derenderer.source}",
        )

    def ensure(self, *, workers: int) -> None:
        """Make what is missing; pictures are needed only while the estimates are not finished."""
        generation.ensure(self.frames.states, workers=workers)
        if not self.is_finished():
            self.frames.ensure(workers=workers)
            generation.make(self, workers=workers)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Look at every frame of a shard."""
        done = 0
        with creating(path, self.fields(shard), self.attributes(shard)) as stored:
            for row, sequence, rgb in self.frames.sequences(shard):
                stored["position"][row, sequence], stored["presence_logit"][row, sequence] = self.derenderer(rgb)
                advance(row - done)
                done = row
        advance(len(self.spec.experiments_of_shard(shard)) - done)
        return {}

    def fields(self, shard: int) -> Fields:
        scenario = self.spec.scenario
        frames = (len(self.spec.experiments_of_shard(shard)), 2, scenario.clock.num_frames, scenario.num_slots)
        return {"position": Field((*frames, 3), "<f4"), "presence_logit": Field(frames, "<f4")}

    def sources(self, shard: int) -> dict[str, str]:
        """States and pictures; these may be deleted once they were seen."""
        sources = {"states_sha256": self.frames.states.checksum(shard)}
        if pictures := self.frames.checksums():
            sources["images_sha256"] = pictures[self.path(shard).name]
        return sources

    def description(self) -> dict[str, Any]:
        """Which checkpoint saw which pictures."""
        return {
            "dataset": self.frames.states.directory.name,
            "images": self.frames.name,
            "derenderer": self.derenderer.name,
            "checkpoint": str(self.derenderer.source),
        }
