"""What a de-renderer sees in every frame of a dataset, in shards beside the pictures' states."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from cophy.dataset.pictures import Pictures
from cophy.dataset.shardset import DamagedShardError, ShardSet, dataset_in
from cophy.scenario.rendering import RenderSettings


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

    position: (experiment, 2, T, slot, 3) float32, metres. presence_logit: (experiment, 2, T, slot) float32.
    """

    def __init__(self, images: Pictures, derenderer: Sees) -> None:
        self.images, self.derenderer = images, derenderer
        spec = images.spec
        command = f"{images.command_for_estimates} derenderer={derenderer.source}"
        super().__init__(
            spec,
            images.states.directory / f"derendered-{derenderer.name}",
            title=f"de-rendered {images.states.title}",
            command=command,
        )

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Look at every frame of a shard."""
        layout = self._layout(shard)
        with h5py.File(path, "w", libver=("v110", "v110")) as file:
            file.attrs.update(self._sources(shard))
            stored = {
                name: file.create_dataset(name, shape, dtype, track_times=False)
                for name, (shape, dtype) in layout.items()
            }
            done = 0
            for row, sequence, rgb in self.images.sequences(shard):
                stored["position"][row, sequence], stored["presence_logit"][row, sequence] = self.derenderer(rgb)
                advance(row - done)
                done = row
            advance(len(self.spec.experiments_of_shard(shard)) - done)
        return {}

    def check(self, path: Path, shard: int) -> None:
        """Read it all; it must be of the states beside it and, while these are there, of the pictures."""
        self._read(path, shard)

    def description(self) -> dict[str, Any]:
        """Which checkpoint saw which pictures."""
        return {
            "dataset": self.images.states.directory.name,
            "images": self.images.name,
            "derenderer": self.derenderer.name,
            "checkpoint": str(self.derenderer.source),
        }

    def load(self) -> dict[str, np.ndarray]:
        """All estimates, experiments in order; zero where there are no pictures."""
        checksums = self.finished_checksums()
        shards = []
        for shard in range(self.spec.num_shards):
            with self.explained(shard):
                self.verify(shard, checksums[self.path(shard).name])
                shards.append(self._read(self.path(shard), shard))
        return {name: np.concatenate([arrays[name] for arrays in shards]) for name in shards[0]}

    def _read(self, path: Path, shard: int) -> dict[str, np.ndarray]:
        try:
            with h5py.File(path, "r") as file:
                layout = self._layout(shard)
                if any(file.attrs[name] != checksum for name, checksum in self._sources(shard).items()):
                    raise DamagedShardError("it is of other states or pictures than those beside it")
                return {name: np.asarray(dataset_in(file, name, *what)[()]) for name, what in layout.items()}
        except (OSError, KeyError, RuntimeError) as error:
            raise DamagedShardError(" ".join(str(error).split())) from error

    def _sources(self, shard: int) -> dict[str, str]:
        """Checksums of what the estimates are of; pictures may be deleted once they were seen."""
        sources = {"states_sha256": self.images.checksum_of_states(shard)}
        if pictures := self.images.checksums():
            sources["images_sha256"] = pictures[self.path(shard).name]
        return sources

    def _layout(self, shard: int) -> dict[str, tuple[tuple[int, ...], str]]:
        scenario = self.spec.scenario
        frames = (len(self.spec.experiments_of_shard(shard)), 2, scenario.clock.num_frames, scenario.num_slots)
        return {"position": ((*frames, 3), "<f4"), "presence_logit": (frames, "<f4")}
