"""Datasets of experiments for PyTorch, and the data module of the predictors.

`CounterfactualDataModule` generates missing data and holds all splits in memory; its batches are slices. The order of training
batches depends on seed and epoch alone, so a resumed training sees the same batches as an uninterrupted one. A batch is divided
among devices: its size is that of a whole optimiser step (in validation and test, that of a device). `ExperimentDataset` is what
`cophy.load` returns.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import lightning as L
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from cophy.dataset import generation
from cophy.dataset.estimates import DerendererProtocol, Estimates
from cophy.dataset.experiment_set import INPUTS, TEST_INPUTS, ExperimentSet, FrameSource, ReadImages
from cophy.dataset.features import confounder_features, confounder_statistics, reduce_to_frames, to_batch
from cophy.dataset.shards import Arrays
from cophy.dataset.splits import SPLITS, Split
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.types import Batch, take


class DeviceShare(NamedTuple):
    """The items of every batch that one device gets: every `devices`-th, starting at `rank`."""

    devices: int = 1
    rank: int = 0

    @classmethod
    def of(cls, trainer: L.Trainer | None) -> "DeviceShare":
        """Return the share of the device of this process."""
        return cls() if trainer is None else cls(trainer.world_size, trainer.global_rank)


ONE_DEVICE = DeviceShare()


def shuffled_batches(dataset: Dataset, batch_size: int, *, seed: int, share: DeviceShare) -> dict[str, Any]:
    """Return arguments of a DataLoader whose batches have each item once per epoch, in a different order in every epoch.

    With several devices, some items are repeated so that all get equally many. Lightning sets the epoch of the sampler, and
    replaces it for trainer.overfit_batches.

    Args:
        batch_size: Items in a batch of all devices together.
        seed: The order depends on it and the epoch. PyTorch adds the two, so seed 1 starts with the order that seed 0 has in
            its second epoch; but their initial weights differ.
        share: Share of this device.
    """
    if batch_size % share.devices:
        raise CophyError(
            f"training.batch_size={batch_size} cannot be shared by {share.devices} devices: use a multiple"
        )
    order: DistributedSampler[int] = DistributedSampler(
        dataset, num_replicas=share.devices, rank=share.rank, shuffle=True, seed=seed
    )
    return {"sampler": order, "batch_size": batch_size // share.devices}


def ordered_batches(groups: np.ndarray, batch_size: int, share: DeviceShare) -> list[list[int]]:
    """Return this device's batches in order. No item is repeated and no group split; all devices have equally many batches.

    Args:
        groups: (item,) equal for consecutive items that stay in one batch, such as twins.
        batch_size: Approximate number of items in a batch.
        share: Share of this device.

    Raises:
        CophyError: There are fewer groups than devices.
    """
    first = np.flatnonzero(np.diff(groups, prepend=groups[0] - 1))
    if len(first) < share.devices:
        raise CophyError(f"{len(first)} groups of experiments cannot be shared by {share.devices} devices")
    items = np.split(np.arange(len(groups)), first[1:])
    shares = [items[part[0] : part[-1] + 1] for part in np.array_split(np.arange(len(items)), share.devices)]
    most = max(sum(map(len, each)) for each in shares)
    num_batches = min(-(-most // batch_size), *map(len, shares))
    batches = np.array_split(np.arange(len(shares[share.rank])), num_batches)
    return [np.concatenate([shares[share.rank][group] for group in batch]).tolist() for batch in batches]


class CounterfactualDataset(Dataset[Batch]):
    """Experiments in memory: a batch is fetched at once, so no worker processes are needed."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch)

    def __getitems__(self, indices: list[int]) -> Batch:
        return take(self.batch, indices)

    def shuffled(self, batch_size: int, *, seed: int = 0, share: DeviceShare = ONE_DEVICE) -> DataLoader[Batch]:
        """Return batches for training, see `shuffled_batches`."""
        return self._loader(**shuffled_batches(self, batch_size, seed=seed, share=share))

    def in_order(self, batch_size: int, *, share: DeviceShare = ONE_DEVICE) -> DataLoader[Batch]:
        """Return all experiments in order, with neighbours that are twins in one batch, see `ordered_batches`."""
        pair = self.batch.targets.pair.numpy()
        groups = np.where(pair < 0, -1 - np.arange(len(pair)), pair)  # in the test split it is unknown which are twins
        return self._loader(batch_sampler=ordered_batches(groups, batch_size, share))

    def _loader(self, **batches: Any) -> DataLoader[Batch]:
        return DataLoader(self, collate_fn=lambda batch: batch, **batches)


class CounterfactualDataModule(L.LightningDataModule):
    """Experiments to train, validate and test on (conf/split).

    Args:
        split: Which experiments are trained on, and which are tested on.
        train_set: Experiments that include those to train and validate on.
        test_set: Experiments that include those to test on; may be the same.
        batch_size: Experiments in a batch, of all devices together.
        workers: Processes that generate missing data.
        seed: Seed of the training: the order of the training experiments depends on it and the epoch.
        derenderer: Provides estimates of AB and C for the splits in `estimated`, instead of true positions.
        estimated: Names of the splits with estimates.
        declared: Optional inputs of the model, see `declared_inputs`.
        needs_confounders: Whether the run needs the true confounders, as input or to learn from.
        num_experiments: Number of training experiments, the first ones; None for all.

    Attributes:
        train, val, test: The three splits, after `setup`.
        test_experiments: (experiment,) index of each test experiment in its dataset.
        knows_confounders: Whether the data contain all true confounders.
        confounder_statistics: Their mean and standard deviation over the training split.
    """

    def __init__(
        self,
        split: Split,
        *,
        train_set: ExperimentSet,
        test_set: ExperimentSet,
        batch_size: int,
        workers: int,
        seed: int = 0,
        derenderer: DerendererProtocol | None = None,
        estimated: Sequence[str] = (),
        declared: Sequence[str] = (),
        needs_confounders: bool = False,
        num_experiments: int | None = None,
    ) -> None:
        super().__init__()
        split.check_scenario(train_set.spec.scenario)
        self.split, self.scenario = split, train_set.spec.scenario
        self.train_set, self.test_set = train_set, test_set
        self.batch_size, self.workers, self.seed = batch_size, workers, seed
        self.derenderer, self.estimated = derenderer, estimated
        self.declared, self.needs_confounders = declared, needs_confounders
        self.num_experiments = num_experiments

    @property
    def dataset_ids(self) -> list[str]:
        """Ids of the datasets: the training one first, then the test one if it differs."""
        return list(dict.fromkeys([self.train_set.id, self.test_set.id]))

    @property
    def trained_on(self) -> list[Any]:
        """Everything that the training batches depend on, as plain values."""
        derenderer = self.derenderer.name if self.derenderer and "train" in self.estimated else None
        task = {key: value for key, value in asdict(self.scenario.task).items() if key != "splits"}  # names, no data
        return [self.train_set.id, self.split.train.as_plain(), task, derenderer]

    def training_checksums(self) -> dict[str, Any]:
        """Return the checksums of the shards that training reads."""
        return {self.train_set.id: self.train_set.checksums()}

    @property
    def mean_position(self) -> Float[Tensor, "3"]:
        """Mean true position of the objects in C over the training split, metres."""
        truth = self.train.batch.targets
        return truth.initial[truth.presence].mean(dim=0)

    def prepare_data(self) -> None:
        """Generate missing data, or index released data."""
        for experiments in (self.train_set, self.test_set):
            generation.ensure(experiments, workers=self.workers)
            if estimates := self._estimates(experiments):
                estimates.ensure(workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Load all splits; confounders are standardised over the training split."""
        if hasattr(self, "train"):
            return
        sets = {experiments.id: experiments for experiments in (self.train_set, self.test_set)}
        stored = {name: self._load(experiments) for name, experiments in sets.items()}
        rows = {split: self._rows(stored, split) for split in SPLITS}
        arrays = {
            split: {name: array[rows[split]] for name, array in stored[self._set_of(split).id].items()}
            for split in SPLITS
        }
        features = {split: confounder_features(arrays[split]) for split in SPLITS}
        self.knows_confounders = not any(values.isnan().any() for values in features.values())
        if self.needs_confounders and not self.knows_confounders:
            raise CophyError(
                f"{self.train_set.directory} does not contain all true confounders, which this run needs: use other data"
            )
        present = torch.from_numpy(arrays["train"]["presence"][:, 0])
        self.confounder_statistics = confounder_statistics(features["train"], present)
        to_split = partial(
            to_batch, scenario=self.scenario, declared=self.declared, statistics=self.confounder_statistics
        )
        self.train, self.val, self.test = (
            CounterfactualDataset(to_split(arrays[split], estimated=split in self.estimated)) for split in SPLITS
        )
        self.test_experiments = rows["test"]

    def train_dataloader(self) -> DataLoader[Batch]:
        return self.train.shuffled(self.batch_size, seed=self.seed, share=DeviceShare.of(self.trainer))

    def val_dataloader(self) -> DataLoader[Batch]:
        return self.val.in_order(self.batch_size, share=DeviceShare.of(self.trainer))

    def test_dataloader(self) -> DataLoader[Batch]:
        return self.test.in_order(self.batch_size, share=DeviceShare.of(self.trainer))

    def _rows(self, stored: dict[str, Arrays], split: str) -> np.ndarray:
        """Return the indices of a split's experiments in their dataset."""
        experiments, part = self._set_of(split), self.split.test if split == "test" else self.split.train
        arrays = stored[experiments.id]
        rows = np.flatnonzero(part.select_split(arrays, split, self.scenario))
        if not len(rows):
            in_split, masks = arrays["split"] == SPLITS.index(split), part.conditions(arrays, self.scenario)
            met = ", ".join(f"{(mask & in_split).sum()} meet {name}" for name, mask in masks.items())
            raise CophyError(
                f"split={self.split.name} leaves no {split} experiments of {experiments.id} "
                f"({in_split.sum()} in all{met and f', {met}'}): {experiments.remedy}"
            )
        if split == "val":  # twins next to each other, for the metrics of twins
            return rows[np.argsort(arrays["twin"][rows], kind="stable")]
        if split != "train" or self.num_experiments is None:
            return rows
        if self.num_experiments > len(rows):
            raise CophyError(f"training.num_experiments={self.num_experiments}: there are {len(rows)} to train on")
        pairs = np.argsort(arrays["twin"][rows], kind="stable")  # whole twin pairs, in random order
        return rows[pairs[: self.num_experiments]]

    def _set_of(self, split: str) -> ExperimentSet:
        return self.test_set if split == "test" else self.train_set

    def _estimates(self, experiments: ExperimentSet) -> Estimates | None:
        """Return the estimates of a dataset, if a split of it needs them."""
        splits = {split for split in self.estimated if self._set_of(split).id == experiments.id}
        if self.derenderer is None or not splits:
            return None
        return Estimates(experiments, self.derenderer, TEST_INPUTS if splits == {"test"} else INPUTS)

    def _load(self, experiments: ExperimentSet) -> Arrays:
        arrays = experiments.load(partial(reduce_to_frames, scenario=self.scenario))
        estimates = self._estimates(experiments)
        if estimates is None:
            return arrays
        if "clip" in arrays and not arrays["clip"].all():
            missing = (~arrays["clip"].all(axis=1)).sum()
            raise CophyError(f"{missing} experiments of {experiments.id} have no RGB clips to estimate positions from")
        rows = arrays.get("experiment", slice(None))  # released data: estimates of all, arrays of the listed ones
        return arrays | {name: array[rows] for name, array in estimates.best_available().load().items()}


class ExperimentDataset(Dataset[dict[str, Tensor]]):
    """Experiments of one split: states and confounders in memory, images read on access.

    An item maps the names of the fields (docs/guides/data.md) to the arrays of one experiment. If an array has two sequences, 0 is
    the observed AB and 1 the counterfactual CD. Images: rgb (2, T, R, R, 3) uint8; depth (2, T, R, R) int32, mm;
    segmentation (2, T, R, R) uint8. Items of one dataset have equal shapes, so a DataLoader batches them.

    Args:
        experiments: A finished set.
        split: train, val or test; None for all.
        frames: Images of the set.
        modalities: Which images are read.

    Raises:
        CophyError: The set is damaged.

    Attributes:
        scenario: Names of slots, do-operations and cells, the clock, the camera.
        rows: Indices of the experiments in the set.
    """

    def __init__(
        self,
        experiments: ExperimentSet,
        *,
        split: str | None,
        frames: FrameSource | None = None,
        modalities: Sequence[str] = (),
    ) -> None:
        arrays = experiments.load()
        numbers = range(len(SPLITS)) if split is None else [SPLITS.index(split)]
        self.rows = np.flatnonzero(np.isin(arrays["split"], numbers))
        self.scenario: Scenario = experiments.spec.scenario
        self.arrays = {name: array[self.rows] for name, array in arrays.items()}
        self._title = experiments.title
        self._frames, self._modalities = frames, tuple(modalities)
        self._places: Arrays = {name: arrays[name] for name in ("experiment", "clip") if name in arrays}
        self._read_images: ReadImages | None = None  # with open files, so every process has its own

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: int) -> dict[str, Tensor]:
        arrays = {name: array[item] for name, array in self.arrays.items()}
        if self._frames is not None:
            if self._read_images is None:
                self._read_images = self._frames.pictures(self._places, self._modalities)
            arrays |= self._read_images(int(self.rows[item]))
        return {name: _to_tensor(np.asarray(array)) for name, array in arrays.items()}

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.shape[1:]}" for name, array in self.arrays.items())
        return ", ".join([f"{len(self)} experiments of {self._title}: {shapes}", *self._modalities])

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_read_images": None}


def _to_tensor(array: np.ndarray) -> Tensor:
    is_depth = array.dtype == np.uint16  # torch has hardly any operations for this type
    return torch.from_numpy(array.astype(np.int32 if is_depth else array.dtype))
