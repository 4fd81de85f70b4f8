"""Single frames for the de-renderer: RGB from image shards or clips, positions and presence from the states."""

from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from cophy.dataset import generation
from cophy.dataset.images import Images
from cophy.dataset.pictures import Pictures, Reader
from cophy.dataset.source import Source, pictures_of
from cophy.dataset.spec import Size
from cophy.dataset.splits import SPLITS, Split
from cophy.scenario import Scenario
from cophy.scenario.rendering import RenderSettings


class FrameBatch(NamedTuple):
    """Frames. image: (B, 3, R, R) uint8; position: (B, K, 3) metres; presence: (B, K), which slots hold an object."""

    image: Tensor
    position: Tensor
    presence: Tensor


class FrameDataset(Dataset[FrameBatch]):
    """Frames of one split, each an (experiment, sequence, time) of a dataset, read when asked for."""

    def __init__(
        self, sources: Sequence[tuple[Pictures, dict[str, np.ndarray]]], *, split: str, resolution: int
    ) -> None:
        self.sources, self.resolution = sources, resolution
        index = []
        for source, (pictures, arrays) in enumerate(sources):
            rows = np.flatnonzero(arrays["split"] == SPLITS.index(split))
            times = range(pictures.spec.scenario.clock.num_frames)
            grid = np.meshgrid([source], rows, [0, 1], times, indexing="ij")
            frames = np.stack(grid, axis=-1).reshape(-1, 4)
            index.append(frames[arrays["clip"][frames[:, 1], frames[:, 2]]] if "clip" in arrays else frames)
        self.index = np.concatenate(index)
        self._readers: dict[int, Reader] = {}

    def __len__(self) -> int:
        return len(self.index)

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
        source, row, sequence, _ = self.index[item].tolist()
        num_frames = self.sources[source][0].spec.scenario.clock.num_frames
        whole.index = np.array([(source, row, sequence, time) for time in range(num_frames)])
        return default_collate([whole[time] for time in range(num_frames)])

    def position_statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation (3,) of the positions of present objects, metres."""
        seen = torch.cat([position[presence] for position, presence in map(self._truth, range(len(self)))])
        return seen.mean(dim=0), seen.std(dim=0)

    def __getitem__(self, item: int) -> FrameBatch:
        source, row, sequence, time = self.index[item].tolist()
        if source not in self._readers:  # by the process that reads
            pictures, arrays = self.sources[source]
            self._readers[source] = pictures.reader(arrays)
        rgb = self._readers[source](row, sequence, time)
        return FrameBatch(to_image(rgb, self.resolution), *self._truth(item))

    def _truth(self, item: int) -> tuple[Tensor, Tensor]:
        source, row, sequence, time = self.index[item].tolist()
        pictures, arrays = self.sources[source]
        state = time * pictures.spec.scenario.clock.states_per_frame
        position, presence = arrays["states"][row, sequence, state, :, :3], arrays["presence"][row, sequence]
        return torch.from_numpy(position), torch.from_numpy(presence)


class FrameDataModule(L.LightningDataModule):
    """Frames of all datasets that a split names, or `num_objects`, rendered first where they are missing.

    Training and validation frames are of the training and validation parts of each dataset, also of the one that the
    split only tests on: a de-renderer has to know every number of objects.
    """

    def __init__(
        self,
        *,
        scenario: Scenario,
        split: Split,
        num_objects: list[int] | None,
        size: Size,
        seed: int,
        data_dir: Path,
        source: Source,
        render: RenderSettings,
        resolution: int,
        num_frames: int,
        batch_size: int,
        workers: int,
    ) -> None:
        super().__init__()
        split.check_scenario(scenario)
        counts = sorted(num_objects or {split.train.num_objects, split.test.num_objects})
        self.states = [
            source.states(scenario, count, split=split, size=size, seed=seed, data_dir=data_dir) for count in counts
        ]
        self.scenario, self.render, self.resolution = scenario, render, resolution
        self.num_frames, self.seed, self.batch_size, self.workers = num_frames, seed, batch_size, workers

    @property
    def dataset_ids(self) -> list[str]:
        """The datasets whose frames are seen."""
        return [states.id for states in self.states]

    @property
    def training_depends_on(self) -> list[Any]:
        """What the training frames are a function of."""
        names = [pictures_of(states, self.render).name for states in self.states]
        return [self.dataset_ids, names, self.num_frames, self.seed]

    def prepare_data(self) -> None:
        """Generate and render what is missing."""
        for states in self.states:
            generation.ensure(states, workers=self.workers)
            pictures = pictures_of(states, self.render)
            if isinstance(pictures, Images):
                generation.ensure(pictures, workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Choose the frames: `num_frames` to train on, and a tenth of that to validate and to test on."""
        if hasattr(self, "train"):
            return
        sources = [(pictures_of(states, self.render), states.load()) for states in self.states]
        self.train, self.val, self.test = (
            FrameDataset(sources, split=split, resolution=self.resolution).sample(count, self.seed)
            for split, count in zip(
                SPLITS, (self.num_frames, self.num_frames // 10, self.num_frames // 10), strict=True
            )
        )

    def train_dataloader(self) -> DataLoader[FrameBatch]:
        return self._loader(self.train, shuffle=True)

    def val_dataloader(self) -> DataLoader[FrameBatch]:
        return self._loader(self.val, shuffle=False)

    def test_dataloader(self) -> DataLoader[FrameBatch]:
        return self._loader(self.test, shuffle=False)

    def _loader(self, frames: FrameDataset, *, shuffle: bool) -> DataLoader[FrameBatch]:
        return DataLoader(
            frames,
            batch_size=self.batch_size,
            shuffle=shuffle,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            multiprocessing_context="fork" if self.workers else None,  # loky, joblib's own, cannot start loaders
        )


def to_image(rgb: np.ndarray, resolution: int) -> Tensor:
    """(R, R, 3) uint8 -> (3, resolution, resolution) uint8, averaged down where it is larger."""
    if rgb.shape[0] != resolution:
        rgb = cv2.resize(rgb, (resolution, resolution), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(np.ascontiguousarray(rgb.transpose(2, 0, 1)))
