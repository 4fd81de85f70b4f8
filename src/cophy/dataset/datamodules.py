"""Data module of the predictors. It generates missing data and holds all splits in memory; batches are slices.

The order of training batches depends on seed and epoch alone, so that a resumed training sees the same batches as an
uninterrupted one. A batch is divided among devices: its size is that of a whole optimiser step.
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
from torch.utils.data import BatchSampler, DataLoader, Dataset, DistributedSampler

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates, Sees
from cophy.dataset.experiment_set import INPUTS, TEST_INPUTS, ExperimentSet
from cophy.dataset.features import (
    Arrays,
    DeclaredInputs,
    confounder_features,
    confounder_statistics,
    reduce_to_frames,
    to_batch,
)
from cophy.dataset.splits import SPLITS, Split
from cophy.errors import CophyError
from cophy.types import Batch, take


class Share(NamedTuple):
    """The part of every batch that one device gets: every `devices`-th item, from `rank` on."""

    devices: int = 1
    rank: int = 0

    @classmethod
    def of(cls, trainer: L.Trainer | None) -> "Share":
        """That of the device that this process runs on."""
        return cls() if trainer is None else cls(trainer.world_size, trainer.global_rank)


ALONE = Share()


class EpochBatches(BatchSampler):
    """Batches in an order of their own in every epoch, which Lightning counts."""

    def set_epoch(self, epoch: int) -> None:
        """Call before an epoch."""
        assert isinstance(self.sampler, DistributedSampler)
        self.sampler.set_epoch(epoch)


def shuffled(dataset: Dataset, batch_size: int, *, seed: int, share: Share) -> EpochBatches:
    """Each item once an epoch; where devices share a run, a few twice, so that all get as many.

    Args:
        dataset: Dataset of the items.
        batch_size: Items in a batch of all devices together.
        seed: The order follows from it and the epoch. PyTorch adds the two, so that seed 1 begins with the order that seed 0
            has in its second epoch; their weights begin differently.
        share: Share of this device.
    """
    if batch_size % share.devices:
        raise CophyError(
            f"training.batch_size={batch_size} cannot be shared by {share.devices} devices: use a multiple"
        )
    order: DistributedSampler[int] = DistributedSampler(
        dataset, num_replicas=share.devices, rank=share.rank, shuffle=True, seed=seed
    )
    return EpochBatches(order, batch_size // share.devices, drop_last=False)


def in_order(groups: np.ndarray, batch_size: int, share: Share) -> list[list[int]]:
    """This device's share of all items, none twice: whole groups that follow each other, in as many batches on each device.

    Args:
        groups: (item,) equal for items that stay in one batch, such as twins; these follow each other.
        batch_size: About as many items are in a batch.
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
    return [[int(item) for group in batch for item in shares[share.rank][group]] for batch in batches]


class CounterfactualDataset(Dataset[Batch]):
    """An index is a list of experiments, an item their `Batch`: sliced at once, no worker processes are worth their cost."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, indices: list[int]) -> Batch:
        return take(self.batch, indices)

    def shuffled(self, batch_size: int, *, seed: int = 0, share: Share = ALONE) -> DataLoader[Batch]:
        """Batches to train on.

        Args:
            batch_size: Experiments in a batch of all devices together.
            seed: Seed of the training.
            share: Share of this device.
        """
        batches = shuffled(self, batch_size, seed=seed, share=share)
        return DataLoader(self, sampler=batches, batch_size=None)

    def in_order(self, batch_size: int, *, share: Share = ALONE) -> DataLoader[Batch]:
        """Every experiment once; twins, which follow each other, stay in one batch.

        Args:
            batch_size: About as many experiments are in a batch.
            share: Share of this device.
        """
        batches = in_order(self.batch.targets.pair.numpy(), batch_size, share)
        return DataLoader(self, sampler=batches, batch_size=None)


class CounterfactualDataModule(L.LightningDataModule):
    """Trains and validates on one part of the data, tests on another or the same (conf/split).

    Attributes:
        train, val, test: The three splits, once `setup` was called.
        test_experiments: (experiment,) the index of each test experiment in its dataset.
        knows_confounders: Whether the data tell all true confounders.
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
        derenderer: Sees | None = None,
        estimated: Sequence[str] = (),
        declared: DeclaredInputs | None = None,
        needs_confounders: bool = False,
        num_experiments: int | None = None,
    ) -> None:
        """Note what is wanted; nothing is read yet.

        Args:
            split: Which experiments are trained on, and which are tested on.
            train_set: The experiments of which some are trained and validated on.
            test_set: The experiments of which some are tested on; may be the same.
            batch_size: Experiments in a batch, of all devices together.
            workers: Processes that make missing data.
            seed: Seed of the training: the order of the training experiments follows from it and the epoch.
            derenderer: Whose estimates of AB and C are seen instead of true positions, or None.
            estimated: Names of the splits of which only the estimates are seen.
            declared: Which optional inputs the model is given; None for none of them.
            needs_confounders: Whether the run needs data that tell them, as input or to learn from.
            num_experiments: So many training experiments are used, the first ones; None for all.
        """
        super().__init__()
        split.check_scenario(train_set.spec.scenario)
        self.split, self.scenario = split, train_set.spec.scenario
        self.train_set, self.test_set = train_set, test_set
        self.batch_size, self.workers, self.seed = batch_size, workers, seed
        self.derenderer, self.estimated = derenderer, estimated
        self.declared, self.needs_confounders = declared or DeclaredInputs(), needs_confounders
        self.num_experiments = num_experiments

    @property
    def dataset_ids(self) -> list[str]:
        """Datasets this split reads: the training one first, then the test one if it is another."""
        return list(dict.fromkeys([self.train_set.id, self.test_set.id]))

    @property
    def trained_on(self) -> list[Any]:
        """All that the training batches are a function of, as plain values."""
        seen = self.derenderer.name if self.derenderer and "train" in self.estimated else None
        task = {key: value for key, value in asdict(self.scenario.task).items() if key != "splits"}  # names, no data
        return [self.train_set.id, asdict(self.split.train), task, seen]

    def training_checksums(self) -> dict[str, Any]:
        """Return the checksums of the shards that training reads."""
        return {self.train_set.id: self.train_set.checksums()}

    @property
    def mean_position(self) -> Float[Tensor, "3"]:
        """Mean true position of the objects in C over the training split, metres."""
        truth = self.train.batch.targets
        return truth.initial[truth.presence].mean(dim=0)

    def prepare_data(self) -> None:
        """Generate what is missing, or index what was released."""
        for experiments in (self.train_set, self.test_set):
            generation.ensure(experiments, workers=self.workers)
            if estimates := self._estimates(experiments):
                estimates.ensure(workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Load all splits; confounders are standardised over the training one."""
        if hasattr(self, "train"):
            return
        stored = {experiments.id: self._load(experiments) for experiments in (self.train_set, self.test_set)}
        arrays = {split: self._select(stored, split) for split in SPLITS}
        features = {split: confounder_features(arrays[split]) for split in SPLITS}
        self.knows_confounders = not any(values.isnan().any() for values in features.values())
        if self.needs_confounders and not self.knows_confounders:
            raise CophyError(
                f"{self.train_set.directory} does not tell all true confounders, which this run needs: use other data"
            )
        statistics = confounder_statistics(features["train"], torch.from_numpy(arrays["train"]["presence"][:, 0]))
        self.train, self.val, self.test = (
            CounterfactualDataset(
                to_batch(
                    arrays[split],
                    self.scenario,
                    self.declared,
                    statistics=statistics,
                    estimated=split in self.estimated,
                )
            )
            for split in SPLITS
        )
        self.test_experiments = np.flatnonzero(self.split.test.select_split(stored[self.test_set.id], "test"))

    def train_dataloader(self) -> DataLoader[Batch]:
        return self.train.shuffled(self.batch_size, seed=self.seed, share=Share.of(self.trainer))

    def val_dataloader(self) -> DataLoader[Batch]:
        return self.val.in_order(self.batch_size, share=Share.of(self.trainer))

    def test_dataloader(self) -> DataLoader[Batch]:
        return self.test.in_order(self.batch_size, share=Share.of(self.trainer))

    def _select(self, arrays: dict[str, Arrays], split: str) -> Arrays:
        """Return the arrays of the experiments of a split."""
        experiments, part = self._set_of(split), self.split.test if split == "test" else self.split.train
        stored = arrays[experiments.id]
        rows = part.select_split(stored, split)
        if not rows.any():
            raise CophyError(
                f"split={self.split.name} leaves no {split} experiments of {experiments.id}: {experiments.remedy}"
            )
        indices = np.flatnonzero(rows)
        if split == "train" and self.num_experiments is not None:
            if self.num_experiments > len(indices):
                raise CophyError(
                    f"training.num_experiments={self.num_experiments}: there are {len(indices)} to train on"
                )
            indices = indices[: self.num_experiments]
        return {name: array[indices] for name, array in stored.items()}

    def _set_of(self, split: str) -> ExperimentSet:
        return self.test_set if split == "test" else self.train_set

    def _estimates(self, experiments: ExperimentSet) -> Estimates | None:
        """Those of a dataset, if one of the splits that are read from it is seen through them."""
        seen = {split for split in self.estimated if self._set_of(split).id == experiments.id}
        if self.derenderer is None or not seen:
            return None
        return Estimates(experiments, self.derenderer, TEST_INPUTS if seen == {"test"} else INPUTS)

    def _load(self, experiments: ExperimentSet) -> Arrays:
        arrays = experiments.load(partial(reduce_to_frames, scenario=self.scenario))
        estimates = self._estimates(experiments)
        if estimates is None:
            return arrays
        if "clip" in arrays and not arrays["clip"].all():
            missing = (~arrays["clip"].all(axis=1)).sum()
            raise CophyError(f"{missing} experiments of {experiments.id} have no RGB clips to estimate positions from")
        rows = arrays.get("experiment", slice(None))
        return arrays | {name: array[rows] for name, array in estimates.or_more().load().items()}
