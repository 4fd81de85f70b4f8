"""Single frames for de-renderers: RGB from image shards or clips, positions and presence from the states."""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.utils.data import Dataset, default_collate

from cophy.dataset.splits import SPLITS
from cophy.dataset.store.experiment_set import FrameSource, Reader


class FrameBatch(NamedTuple):
    """Frames, and what is to be seen in them.

    Attributes:
        image: RGB.
        position: True positions, metres.
        presence: Which slots hold an object.
    """

    image: UInt8[Tensor, "*batch 3 height width"]
    position: Float[Tensor, "*batch slots 3"]
    presence: Bool[Tensor, "*batch slots"]


class FrameDataset(Dataset[FrameBatch]):
    """Frames of one split, each an (experiment, sequence, time) of some dataset, read when asked for."""

    def __init__(
        self, sources: Sequence[tuple[FrameSource, dict[str, np.ndarray]]], *, split: str, resolution: int
    ) -> None:
        """Count the frames.

        Args:
            sources: Pictures of a dataset, and its arrays.
            split: train, val or test.
            resolution: Edge of the images in pixels; larger pictures are averaged down.
        """
        self.sources, self.resolution = list(sources), resolution
        index = []
        for source, (pictures, arrays) in enumerate(sources):
            rows = np.flatnonzero(arrays["split"] == SPLITS.index(split))
            times = range(pictures.states.spec.scenario.clock.num_frames)
            grid = np.meshgrid([source], rows, [0, 1], times, indexing="ij")
            frames = np.stack(grid, axis=-1).reshape(-1, 4)
            index.append(frames[arrays["clip"][frames[:, 1], frames[:, 2]]] if "clip" in arrays else frames)
        self.index = np.concatenate(index)
        self._readers: dict[int, Reader] = {}

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, item: int) -> FrameBatch:
        source, row, sequence, time = self.index[item].tolist()
        if source not in self._readers:  # by the process that reads
            pictures, arrays = self.sources[source]
            self._readers[source] = pictures.reader(arrays)
        rgb = self._readers[source](row, sequence, time)
        return FrameBatch(to_image(rgb, self.resolution), *self._truth(item))

    def sample(self, count: int, seed: int) -> "FrameDataset":
        """Keep `count` frames at random, or all where there are no more."""
        chosen = np.random.default_rng(seed).permutation(len(self.index))[:count]
        self.index = self.index[np.sort(chosen)]
        return self

    @property
    def pairs(self) -> np.ndarray:
        """(frame,) which twin pair, of all sources, a frame is of."""
        twin = [self.sources[source][1]["twin"][row] for source, row in self.index[:, :2]]
        return np.array(twin) * len(self.sources) + self.index[:, 0]

    def sequence_of(self, item: int) -> FrameBatch:
        """All frames, in time, of the sequence that a frame is from."""
        whole = copy(self)
        whole.index = self.sequence_index(item)
        return default_collate([whole[time] for time in range(len(whole))])

    def sequence_index(self, item: int) -> np.ndarray:
        """(T, 4) where the frames of the sequence lie that a frame is from: source, experiment, sequence, time."""
        source, row, sequence, _ = self.index[item].tolist()
        num_frames = self.sources[source][0].states.spec.scenario.clock.num_frames
        return np.array([(source, row, sequence, time) for time in range(num_frames)])

    def position_statistics(self) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
        """Mean and standard deviation of the positions of present objects, metres."""
        seen = torch.cat([position[presence] for position, presence in map(self._truth, range(len(self)))])
        return seen.mean(dim=0), seen.std(dim=0)

    def _truth(self, item: int) -> tuple[Tensor, Tensor]:
        source, row, sequence, time = self.index[item].tolist()
        pictures, arrays = self.sources[source]
        state = time * pictures.states.spec.scenario.clock.states_per_frame
        position, presence = arrays["states"][row, sequence, state, :, :3], arrays["presence"][row, sequence]
        return torch.from_numpy(position), torch.from_numpy(presence)


def to_image(rgb: np.ndarray, resolution: int) -> UInt8[Tensor, "3 resolution resolution"]:
    """A square (R, R, 3) uint8 picture as a tensor, averaged down where it is larger than `resolution`."""
    if rgb.shape[0] != resolution:
        rgb = cv2.resize(rgb, (resolution, resolution), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(np.ascontiguousarray(rgb.transpose(2, 0, 1)))
