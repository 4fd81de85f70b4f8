"""Experiments for predictors: makes what is missing, and holds all splits in memory."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import lightning as L
import numpy as np
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import DataLoader

from cophy.dataset import generation
from cophy.dataset.feed.appearance_features import with_appearance
from cophy.dataset.feed.batch_order import Share
from cophy.dataset.feed.batches import frames_of, frames_to_batch, with_estimates
from cophy.dataset.feed.confounder_features import confounder_features, confounder_statistics, standardised
from cophy.dataset.feed.counterfactual_dataset import CounterfactualDataset
from cophy.dataset.feed.declared_inputs import DeclaredInputs
from cophy.dataset.pictures.estimates import Estimates, Sees
from cophy.dataset.pictures.needed_frames import INPUTS, TEST_INPUTS
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.state_features import Arrays
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.errors import CophyError
from cophy.types import Batch


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
            seed: Of the training: the order of the training experiments follows from it and the epoch.
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
        arrays = {each.id: self._load(each) for each in (self.train_set, self.test_set)}
        chosen = {split: self._select(arrays, split) for split in SPLITS}
        batches = {split: self._batch(chosen[split]) for split in SPLITS}
        self._add_confounders(batches, chosen)
        for split in self.estimated:
            batches[split] = with_estimates(batches[split], chosen[split], self.scenario)
        self.test_experiments = np.flatnonzero(self.split.test.select_split(arrays[self.test_set.id], "test"))
        self.train, self.val, self.test = (CounterfactualDataset(batches[split]) for split in SPLITS)

    def train_dataloader(self) -> DataLoader[Batch]:
        return self.train.shuffled(self.batch_size, seed=self.seed, share=Share.of(self.trainer))

    def val_dataloader(self) -> DataLoader[Batch]:
        return self.val.in_order(self.batch_size, share=Share.of(self.trainer))

    def test_dataloader(self) -> DataLoader[Batch]:
        return self.test.in_order(self.batch_size, share=Share.of(self.trainer))

    def _select(self, arrays: dict[str, Arrays], split: str) -> Arrays:
        experiments, part = self._set_of(split), self.split.test if split == "test" else self.split.train
        stored = arrays[experiments.id]
        rows = part.select_split(stored, split)
        if not rows.any():
            raise CophyError(
                f"split={self.split.name} leaves no {split} experiments of {experiments.id}: {experiments.remedy}"
            )
        kept = np.flatnonzero(rows)
        if split == "train" and self.num_experiments is not None:
            if self.num_experiments > len(kept):
                raise CophyError(f"training.num_experiments={self.num_experiments}: there are {len(kept)} to train on")
            kept = kept[: self.num_experiments]
        return {name: array[kept] for name, array in stored.items()}

    def _batch(self, arrays: Arrays) -> Batch:
        return with_appearance(frames_to_batch(arrays, self.scenario), arrays, self.declared)

    def _set_of(self, split: str) -> ExperimentSet:
        return self.test_set if split == "test" else self.train_set

    def _add_confounders(self, batches: dict[str, Batch], chosen: dict[str, Arrays]) -> None:
        features = {split: confounder_features(chosen[split]) for split in SPLITS}
        self.knows_confounders = not any(values.isnan().any() for values in features.values())
        if self.needs_confounders and not self.knows_confounders:
            raise CophyError(
                f"{self.train_set.directory} does not tell all true confounders, which this run needs: use other data"
            )
        if not self.declared.confounders:
            return
        presence = {split: batches[split].inputs.observed_presence for split in SPLITS}
        statistics = confounder_statistics(features["train"], presence["train"])
        for split, batch in batches.items():
            given = standardised(features[split], presence[split], statistics)
            batches[split] = replace(batch, inputs=replace(batch.inputs, confounders=given))

    def _estimates(self, experiments: ExperimentSet) -> Estimates | None:
        """Those of a dataset, if one of the splits that are read from it is seen through them."""
        seen = {split for split in self.estimated if self._set_of(split).id == experiments.id}
        if self.derenderer is None or not seen:
            return None
        return Estimates(experiments, self.derenderer, TEST_INPUTS if seen == {"test"} else INPUTS)

    def _load(self, experiments: ExperimentSet) -> Arrays:
        arrays = experiments.load(partial(frames_of, scenario=self.scenario))
        estimates = self._estimates(experiments)
        if estimates is None:
            return arrays
        if "clip" in arrays and not arrays["clip"].all():
            missing = (~arrays["clip"].all(axis=1)).sum()
            raise CophyError(f"{missing} experiments of {experiments.id} have no RGB clips to estimate positions from")
        rows = arrays.get("experiment", slice(None))
        return arrays | {name: array[rows] for name, array in estimates.or_more().load().items()}
