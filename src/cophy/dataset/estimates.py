"""Estimates of a de-renderer for the images of a dataset, in shards next to the states."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from cophy.dataset import generation
from cophy.dataset.experiment_set import ALL_FRAMES, ExperimentSet, NeededFrames
from cophy.dataset.shards import Field, Fields, ShardSet, create_file
from cophy.scenario.rendering import RenderSettings


class DerendererProtocol(Protocol):
    """A trained de-renderer. name: hash of its checkpoint. source: the checkpoint. render: how its images are rendered."""

    name: str
    source: Path
    render: RenderSettings

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, R, R, 3) uint8 -> positions (N, K, 3) in metres, presence logits (N, K)."""


class Estimates(ShardSet):
    """Estimates for frames of AB (sequence 0) and CD (1).

    position: (experiment, 2, T, slot, 3) float32, metres. presence_logit: (experiment, 2, T, slot) float32. Both are zero
    for frames without an image.
    """

    def __init__(
        self, states: ExperimentSet, derenderer: DerendererProtocol, needed: NeededFrames = ALL_FRAMES
    ) -> None:
        self.states, self.derenderer = states, derenderer
        self.frames = states.frames(derenderer.render, needed)
        self.needed = self.frames.needed
        suffix = "" if self.needed == ALL_FRAMES else f"-{self.needed.name}"
        super().__init__(
            states.spec,
            states.directory / f"derendered-{derenderer.name}{suffix}",
            title=f"de-rendered {states.title}",
            command=f"{states.command_for('derender')} {shlex.quote(f'derenderer={derenderer.source}')} {self.needed.keys}".rstrip(),
        )

    def best_available(self) -> "Estimates":
        """Return this set if it is finished, otherwise a finished superset, otherwise this set."""
        sets = [Estimates(self.states, self.derenderer, needed) for needed in (self.needed, *self.needed.supersets)]
        return next((estimates for estimates in sets if estimates.is_finished()), self)

    def ensure(self, *, workers: int) -> None:
        """Generate what is missing; images are needed only while the estimates are not finished."""
        generation.ensure(self.states, workers=workers)
        if not self.best_available().is_finished():
            self.frames.ensure(workers=workers)
            generation.make(self, workers=workers)

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """De-render the frames of a shard."""
        torch.set_num_threads(1)  # several processes work in parallel
        done = 0
        with create_file(path, self.fields(shard), self.attributes(shard)) as stored:
            for row, sequence, times, rgb in self.frames.sequences(shard):
                stored["position"][row, sequence, times], stored["presence_logit"][row, sequence, times] = (
                    self.derenderer(rgb)
                )
                advance(row - done)
                done = row
        advance(len(self.spec.experiments_of_shard(shard)) - done)
        return {}

    def fields(self, shard: int) -> Fields:
        scenario = self.spec.scenario
        frames = (len(self.spec.experiments_of_shard(shard)), 2, scenario.clock.num_frames, scenario.num_slots)
        return {"position": Field((*frames, 3), "<f4"), "presence_logit": Field(frames, "<f4")}

    def input_checksums(self, shard: int) -> dict[str, str]:
        """Return the SHA-256 of the states and, if this set of images still exists, of the images."""
        images = self.frames.checksums() or {}
        digests = {"states_sha256": self.states.checksum(shard), "images_sha256": images.get(self.path(shard).name)}
        return {name: digest for name, digest in digests.items() if digest is not None}

    def description(self) -> dict[str, Any]:
        """Return which checkpoint was applied to which images."""
        return {
            "dataset": self.states.directory.name,
            "images": self.frames.name,
            "derenderer": self.derenderer.name,
            "checkpoint": str(self.derenderer.source),
        }
