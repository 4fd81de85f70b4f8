"""Frames for de-renderers: makes and renders what is missing, and chooses frames at random.

Single frames for de-renderers: RGB from image shards or clips, positions and presence from the states.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from typing import Any, NamedTuple

import cv2
import lightning as L
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from cophy.dataset import generation
from cophy.dataset.datamodules import Share, in_order, shuffled
from cophy.dataset.experiment_set import ChosenFrames, ExperimentSet, FrameSource, Reader
from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.scenario.rendering import RenderSettings


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
        """Return a dataset of `count` frames drawn at random, or of all frames if there are no more."""
        indices = np.random.default_rng(seed).permutation(len(self.index))[:count]
        return self._restricted_to(self.index[np.sort(indices)])

    def _restricted_to(self, index: np.ndarray) -> "FrameDataset":
        dataset = copy(self)
        dataset.index, dataset._readers = index, {}
        return dataset

    @property
    def pairs(self) -> np.ndarray:
        """(frame,) which twin pair, of all sources, a frame is of."""
        twin = [self.sources[source][1]["twin"][row] for source, row in self.index[:, :2]]
        return np.array(twin) * len(self.sources) + self.index[:, 0]

    def sequence_of(self, item: int) -> FrameBatch:
        """All frames, in time, of the sequence that a frame is from."""
        whole = self._restricted_to(self.sequence_index(item))
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


class FrameDataModule(L.LightningDataModule):
    """Frames of several datasets of one scenario.

    Training and validation frames are of the training and validation parts of each dataset, also of one that the
    split only tests on: a de-renderer has to know every number of objects. Only the frames that were chosen are rendered,
    unless they are half of all or more: then the others are, too, for models look at them later.

    Attributes:
        train, val, test: The three splits, once `setup` was called.
    """

    def __init__(
        self,
        sets: Sequence[ExperimentSet],
        *,
        render: RenderSettings,
        resolution: int,
        num_images: int,
        data_seed: int,
        batch_size: int,
        workers: int,
        seed: int = 0,
    ) -> None:
        """Note what is wanted; nothing is read yet.

        Args:
            sets: Experiments, one set for each number of objects.
            render: The pictures to take frames of, rendered first where they are missing.
            resolution: Edge of the images that the de-renderer sees, pixels.
            num_images: Frames to train on; a tenth of it to validate, and as many to test on.
            data_seed: Says which frames are chosen.
            batch_size: Frames in a batch, of all devices together.
            workers: Processes that make missing data, and that read frames.
            seed: Seed of the training: the order of the training frames follows from it and the epoch.
        """
        super().__init__()
        self.sets, self.scenario = sets, sets[0].spec.scenario
        self.render, self.resolution, self.num_images = render, resolution, num_images
        self.data_seed, self.batch_size, self.workers, self.seed = data_seed, batch_size, workers, seed

    @property
    def dataset_ids(self) -> list[str]:
        """The datasets whose frames are seen."""
        return [experiments.id for experiments in self.sets]

    @property
    def trained_on(self) -> list[Any]:
        """All that the training frames are a function of, as plain values."""
        names = [experiments.frames(self.render).name for experiments in self.sets]
        return [self.dataset_ids, names, self.num_images, self.data_seed]

    def training_checksums(self) -> dict[str, Any]:
        """Return the checksums of the shards that training reads."""
        states = {experiments.id: experiments.checksums() for experiments in self.sets}
        return states | {images.name: images.checksums() for images, _ in self.train.sources}

    def prepare_data(self) -> None:
        """Generate and render what is missing."""
        for experiments in self.sets:
            generation.ensure(experiments, workers=self.workers)
        for pictures, _ in self._chosen()[0].sources:
            pictures.ensure(workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Choose the frames of each split."""
        if hasattr(self, "train"):
            return
        self.train, self.val, self.test = self._chosen()

    def _chosen(self) -> list[FrameDataset]:
        """The frames of each split, and the pictures that hold them."""
        sources = [(experiments.frames(self.render), experiments.load()) for experiments in self.sets]
        for experiments, (_, arrays) in zip(self.sets, sources, strict=True):
            _check_colors(experiments, arrays)
        counts = self.num_images, self.num_images // 10, self.num_images // 10
        splits = [
            FrameDataset(sources, split=split, resolution=self.resolution).sample(count, self.data_seed)
            for split, count in zip(SPLITS, counts, strict=True)
        ]
        looked_at = np.concatenate([*(frames.index for frames in splits), splits[1].sequence_index(0)])
        pictures = [self._pictures(at, looked_at[looked_at[:, 0] == at, 1:]) for at in range(len(sources))]
        for frames in splits:
            frames.sources = [(shown, arrays) for shown, (_, arrays) in zip(pictures, sources, strict=True)]
        return splits

    def _pictures(self, source: int, frames: np.ndarray) -> FrameSource:
        """Pictures of one dataset in which (frame, 3) experiments, sequences and times are seen."""
        experiments = self.sets[source]
        every = 2 * experiments.spec.num_experiments * self.scenario.clock.num_frames
        if 2 * len(frames) >= every:
            return experiments.frames(self.render)
        seen = ",".join(str(each.spec.num_objects) for each in self.sets)  # all of them: frames are chosen from all
        keys = f"model=derenderer num_images={self.num_images} data_seed={self.data_seed} 'num_objects=[{seen}]'"
        return experiments.frames(self.render, ChosenFrames.to_train(frames, keys))

    def train_dataloader(self) -> DataLoader[FrameBatch]:
        batches = shuffled(self.train, self.batch_size, seed=self.seed, share=Share.of(self.trainer))
        # the sampler itself, so that Lightning tells it the epoch
        return self._loader(self.train, sampler=batches.sampler, batch_size=batches.batch_size)

    def val_dataloader(self) -> DataLoader[FrameBatch]:
        return self._in_order(self.val)

    def test_dataloader(self) -> DataLoader[FrameBatch]:
        return self._in_order(self.test)

    def _in_order(self, frames: FrameDataset) -> DataLoader[FrameBatch]:
        batches = in_order(np.arange(len(frames)), self.batch_size, Share.of(self.trainer))
        return self._loader(frames, batch_sampler=batches)

    def _loader(self, frames: FrameDataset, **batches: Any) -> DataLoader[FrameBatch]:
        return FrameLoader(
            frames,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            multiprocessing_context="fork" if self.workers else None,  # loky, joblib's own, cannot start loaders
            **batches,
        )


class FrameLoader(DataLoader[FrameBatch]):
    """Workers begin with the first batch that is asked for, and their errors are as short as anybody's.

    Lightning opens a loader before it says in which epoch a training goes on: those batches were of the first epoch.
    PyTorch puts the traceback of a worker into the message of its error.
    """

    def __iter__(self) -> Iterator[FrameBatch]:  # type: ignore[override]  # PyTorch promises its own class
        try:
            yield from super().__iter__()
        except CophyError as error:
            raise CophyError(str(error).rpartition(f"{CophyError.__module__}.CophyError: ")[2].strip()) from error


def _check_colors(experiments: ExperimentSet, arrays: dict[str, np.ndarray]) -> None:
    """Refuse released towers without colors.txt: their masses, too, are those of unknown blocks, and so NaN.

    Raises:
        CophyError: Says in how many.
    """
    unknown = np.isnan(np.where(arrays["presence"][:, 0], arrays["mass"], 0.0)).any(axis=1)
    if unknown.any():
        raise CophyError(
            f"{experiments.id}: in {unknown.sum()} of {unknown.size} experiments no colors.txt says which object has "
            "which colour; a de-renderer tells objects by their colours"
        )
