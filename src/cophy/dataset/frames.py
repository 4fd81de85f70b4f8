"""Frames for de-renderers, chosen at random: RGB from images or clips, positions and presence from the states."""

from collections.abc import Iterator, Sequence
from copy import copy
from functools import partial
from typing import Any, NamedTuple

import cv2
import lightning as L
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from cophy.dataset import generation
from cophy.dataset.datamodules import DeviceShare, ordered_batches, shuffled_batches
from cophy.dataset.experiment_set import ExperimentSet, FrameReader, FrameSource, single_frames
from cophy.dataset.shards import Arrays
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import reduce_to_frames
from cophy.errors import CophyError
from cophy.scenario.rendering import RenderSettings


class FrameBatch(NamedTuple):
    """Frames, and the objects in them.

    Attributes:
        image: RGB.
        position: True positions, metres.
        presence: Which slots hold an object.
    """

    image: UInt8[Tensor, "*batch 3 height width"]
    position: Float[Tensor, "*batch slots 3"]
    presence: Bool[Tensor, "*batch slots"]


class FrameDataset(Dataset[FrameBatch]):
    """Frames of one split, read on access. Each is an (experiment, sequence, time) of one of several datasets.

    Args:
        sources: Images of each dataset, and its arrays.
        split: train, val or test.
        resolution: Width and height in pixels; larger images are averaged down.

    Attributes:
        index: (frame, 4) source, experiment, sequence, time.
    """

    def __init__(self, sources: Sequence[tuple[FrameSource, Arrays]], *, split: str, resolution: int) -> None:
        self.sources, self.resolution = list(sources), resolution
        index = []
        for source, (images, arrays) in enumerate(sources):
            rows = np.flatnonzero(arrays["split"] == SPLITS.index(split))
            times = range(images.states.spec.scenario.clock.num_frames)
            grid = np.meshgrid([source], rows, [0, 1], times, indexing="ij")
            frames = np.stack(grid, axis=-1).reshape(-1, 4)
            index.append(frames[arrays["clip"][frames[:, 1], frames[:, 2]]] if "clip" in arrays else frames)
        self.index = np.concatenate(index)
        self._readers: dict[int, FrameReader] = {}

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, item: int) -> FrameBatch:
        source, row, sequence, time = self.index[item].tolist()
        if source not in self._readers:  # in the process that reads
            images, arrays = self.sources[source]
            self._readers[source] = images.reader(arrays)
        rgb = self._readers[source](row, sequence, time)
        return FrameBatch(to_image(rgb, self.resolution), *self._truth(item))

    def sample(self, count: int, seed: int) -> "FrameDataset":
        """Return a dataset of `count` frames drawn at random, or of all frames if there are no more."""
        indices = np.random.default_rng(seed).permutation(len(self.index))[:count]
        return self._with(self.index[np.sort(indices)])

    def _with(self, index: np.ndarray) -> "FrameDataset":
        dataset = copy(self)
        dataset.index, dataset._readers = index, {}
        return dataset

    @property
    def clusters(self) -> np.ndarray:
        """(frame,) cluster of the experiment of each frame, see `ExperimentSet.clusters`, different for all sources."""
        clusters = np.zeros(len(self.index), dtype=np.int64)
        for source, (images, _) in enumerate(self.sources):
            chosen = self.index[:, 0] == source
            clusters[chosen] = images.states.clusters(self.index[chosen, 1])
        return clusters * len(self.sources) + self.index[:, 0]

    def sequence_of(self, item: int) -> FrameBatch:
        """Return all frames, in time, of the sequence that contains a frame."""
        frames = self._with(self.sequence_index(item))
        return default_collate([frames[time] for time in range(len(frames))])

    def sequence_index(self, item: int) -> np.ndarray:
        """Return the index, (T, 4), of all frames of the sequence that contains a frame."""
        source, row, sequence, _ = self.index[item].tolist()
        num_frames = self.sources[source][0].states.spec.scenario.clock.num_frames
        return np.array([(source, row, sequence, time) for time in range(num_frames)])

    def position_statistics(self) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
        """Return mean and standard deviation of the positions of present objects, metres."""
        present = torch.cat([position[presence] for position, presence in map(self._truth, range(len(self)))])
        return present.mean(dim=0), present.std(dim=0)

    def _truth(self, item: int) -> tuple[Tensor, Tensor]:
        source, row, sequence, time = self.index[item].tolist()
        _, arrays = self.sources[source]
        position, presence = arrays["states"][row, sequence, time, :, :3], arrays["presence"][row, sequence]
        return torch.from_numpy(position), torch.from_numpy(presence)


def to_image(rgb: np.ndarray, resolution: int) -> UInt8[Tensor, "3 resolution resolution"]:
    """Return a square (R, R, 3) uint8 image as a tensor, averaged down if it is larger than `resolution`."""
    if rgb.shape[0] != resolution:
        rgb = cv2.resize(rgb, (resolution, resolution), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(np.ascontiguousarray(rgb.transpose(2, 0, 1)))


class FrameDataModule(L.LightningDataModule):
    """Frames of several datasets of one scenario.

    Datasets that are only used for testing also contribute training and validation frames, from their own training and
    validation splits, so that a de-renderer knows every number of objects. If at least half of all frames are chosen, all
    are rendered, because predictors need the others later.

    Args:
        sets: Experiments, one set for each number of objects.
        render: The images to take frames from; missing ones are rendered first.
        resolution: Width and height of the de-renderer's images, pixels.
        num_images: Frames to train on; a tenth of it to validate on, and a tenth to test on.
        data_seed: Seed of the choice of frames.
        batch_size: Frames in a batch, of all devices together.
        workers: Processes that generate missing data, and that read frames.
        seed: Seed of the training: the order of the training frames depends on it and the epoch.

    Attributes:
        train, val, test: The three splits, after `setup`.
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
        super().__init__()
        self.sets, self.scenario = sets, sets[0].spec.scenario
        self.render, self.resolution, self.num_images = render, resolution, num_images
        self.data_seed, self.batch_size, self.workers, self.seed = data_seed, batch_size, workers, seed

    @property
    def dataset_ids(self) -> list[str]:
        """Ids of the datasets."""
        return [experiments.id for experiments in self.sets]

    @property
    def trained_on(self) -> list[Any]:
        """Everything that the training frames depend on, as plain values."""
        names = [experiments.frames(self.render).name for experiments in self.sets]
        return [self.dataset_ids, names, self.num_images, self.data_seed]

    def training_checksums(self) -> dict[str, Any]:
        """Return the checksums of the shards that training reads."""
        states = {experiments.id: experiments.checksums() for experiments in self.sets}
        return states | {images.name: images.checksums() for images, _ in self.train.sources}

    def prepare_data(self) -> None:
        """Generate and render missing data."""
        for experiments in self.sets:
            generation.ensure(experiments, workers=self.workers)
        for images, _ in self._choose()[0].sources:
            images.ensure(workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Choose the frames of each split."""
        if not hasattr(self, "train"):
            self.train, self.val, self.test = self._choose()

    def _choose(self) -> list[FrameDataset]:
        """Return the frames of each split, from images that contain only these if they are few."""
        reduce = partial(reduce_to_frames, scenario=self.scenario)
        sources = [(experiments.frames(self.render), experiments.load(reduce)) for experiments in self.sets]
        for experiments, (_, arrays) in zip(self.sets, sources, strict=True):
            _check_colors(experiments, arrays)
        counts = self.num_images, self.num_images // 10, self.num_images // 10
        splits = [
            FrameDataset(sources, split=split, resolution=self.resolution).sample(count, self.data_seed)
            for split, count in zip(SPLITS, counts, strict=True)
        ]
        if empty := [split for split, frames in zip(SPLITS, splits, strict=True) if not len(frames)]:
            raise CophyError(f"{', '.join(self.dataset_ids)}: there are no {empty[0]} frames: {self.sets[0].remedy}")
        index = np.concatenate(
            [*(frames.index for frames in splits), splits[1].sequence_index(0)]
        )  # TensorBoard shows a sequence
        sources = [
            (self._images(experiments, index[index[:, 0] == number, 1:]), arrays)
            for number, (experiments, (_, arrays)) in enumerate(zip(self.sets, sources, strict=True))
        ]
        for frames in splits:
            frames.sources = sources
        return splits

    def _images(self, experiments: ExperimentSet, frames: np.ndarray) -> FrameSource:
        """Return the images of a dataset that contain these frames, (frame, 3) experiment, sequence and time."""
        num_frames = 2 * experiments.spec.num_experiments * self.scenario.clock.num_frames
        if 2 * len(frames) >= num_frames:
            return experiments.frames(self.render)
        counts = ",".join(str(each.spec.num_objects) for each in self.sets)  # the frames are chosen from all datasets
        keys = f"model=derenderer num_images={self.num_images} data_seed={self.data_seed} 'num_objects=[{counts}]'"
        return experiments.frames(self.render, single_frames(frames, keys))

    def train_dataloader(self) -> DataLoader[FrameBatch]:
        batches = shuffled_batches(self.train, self.batch_size, seed=self.seed, share=DeviceShare.of(self.trainer))
        return self._loader(self.train, **batches)

    def val_dataloader(self) -> DataLoader[FrameBatch]:
        return self._in_order(self.val)

    def test_dataloader(self) -> DataLoader[FrameBatch]:
        return self._in_order(self.test)

    def _in_order(self, frames: FrameDataset) -> DataLoader[FrameBatch]:
        batches = ordered_batches(np.arange(len(frames)), self.batch_size, DeviceShare.of(self.trainer))
        return self._loader(frames, batch_sampler=batches)

    def _loader(self, frames: FrameDataset, **batches: Any) -> DataLoader[FrameBatch]:
        return FrameLoader(
            frames,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            multiprocessing_context="fork" if self.workers else None,  # joblib's "loky" cannot start loaders
            **batches,
        )


class FrameLoader(DataLoader[FrameBatch]):
    """Loader that starts its workers with the first batch and raises their errors in one line.

    Lightning opens a loader before it sets the epoch of a resumed training: those batches would be of the first epoch. PyTorch
    puts the traceback of a worker into the message of its error.
    """

    def __iter__(self) -> Iterator[FrameBatch]:  # type: ignore[override]  # PyTorch promises its own class
        try:
            yield from super().__iter__()
        except CophyError as error:
            raise CophyError(str(error).rpartition(f"{CophyError.__module__}.CophyError: ")[2].strip()) from error


def _check_colors(experiments: ExperimentSet, arrays: Arrays) -> None:
    """Refuse released towers without colors.txt, whose masses are NaN because their blocks are unknown."""
    unknown = np.isnan(np.where(arrays["presence"][:, 0], arrays["mass"], 0.0)).any(axis=1)
    if unknown.any():
        raise CophyError(
            f"{experiments.id}: in {unknown.sum()} of {unknown.size} experiments no colors.txt says which object has "
            "which colour; a de-renderer tells objects by their colours"
        )
