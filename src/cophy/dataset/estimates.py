"""What a de-renderer sees in the frames of a dataset, in shards beside the states that the pictures show."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from cophy.dataset import generation
from cophy.dataset.experiment_set import ALL, ExperimentSet, NeededFrames
from cophy.dataset.shards import Field, Fields, ShardSet, attribute, creating, reading
from cophy.scenario.rendering import RenderSettings

PICTURES = "images_sha256"  # attribute of a file: of the pictures that were seen


class Sees(Protocol):
    """A trained de-renderer. name: of its checkpoint, by content. source: where that lies. render: the pictures it knows."""

    name: str
    source: Path
    render: RenderSettings

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""
        ...


class Estimates(ShardSet):
    """Estimates of frames of AB (sequence 0) and CD (1).

    position: (experiment, 2, T, slot, 3) float32, metres. presence_logit: (experiment, 2, T, slot) float32. Both are zero
    where there are no pictures.
    """

    def __init__(self, states: ExperimentSet, derenderer: Sees, needed: NeededFrames = ALL) -> None:
        self.states, self.derenderer = states, derenderer
        self.frames = states.frames(derenderer.render, needed)
        self.needed = self.frames.needed
        of_some = "" if self.needed == ALL else f"-{self.needed.name}"
        super().__init__(
            states.spec,
            states.directory / f"derendered-{derenderer.name}{of_some}",
            title=f"de-rendered {states.title}",
            command=f"{states.command_for('derender')} derenderer={derenderer.source}{self.needed.drawn_by[1]}",
        )

    def or_more(self) -> "Estimates":
        """The set that estimates are read from: itself, or where it is not there, a finished one of more frames."""
        sets = [Estimates(self.states, self.derenderer, needed) for needed in (self.needed, *self.needed.wider)]
        return next((found for found in sets if found.is_finished()), self)

    def ensure(self, *, workers: int) -> None:
        """Make what is missing; pictures are needed only while the estimates are not finished."""
        generation.ensure(self.states, workers=workers)
        if not self.or_more().is_finished():
            self.frames.ensure(workers=workers)
            generation.make(self, workers=workers)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Look at the frames of a shard."""
        done = 0
        with creating(path, self.fields(shard), self.attributes(shard)) as stored:
            for row, sequence, times, rgb in self.frames.sequences(shard):
                position, presence_logit = self.derenderer(rgb)
                stored["position"][row, sequence, times] = position
                stored["presence_logit"][row, sequence, times] = presence_logit
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
        sources = {"states_sha256": self.states.checksum(shard)}
        if pictures := self.frames.checksums():
            sources[PICTURES] = pictures[self.path(shard).name]
        return sources

    def opened(self, path: Path, shard: int) -> AbstractContextManager[dict[str, h5py.Dataset]]:
        sources = self.sources(shard)
        if attribute(path, PICTURES) is None:  # a set with more pictures was seen
            sources.pop(PICTURES, None)
        return reading(path, self.fields(shard), sources)

    def description(self) -> dict[str, Any]:
        """Which checkpoint saw which pictures."""
        return {
            "dataset": self.states.directory.name,
            "images": self.frames.name,
            "derenderer": self.derenderer.name,
            "checkpoint": str(self.derenderer.source),
        }
