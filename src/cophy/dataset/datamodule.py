"""LightningDataModule over generated data: makes what is missing, holds everything in memory."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from cophy.dataset import generation
from cophy.dataset.counterfactual import (
    CounterfactualDataset,
    confounder_statistics,
    select,
    selected,
    standardise,
    to_batch,
    with_estimates,
)
from cophy.dataset.estimates import Estimates, Sees
from cophy.dataset.images import Images
from cophy.dataset.oracles import OracleForecasts, OracleSettings
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.types import Batch


class CounterfactualDataModule(L.LightningDataModule):
    """Trains and validates on one part of the data, tests on another (or the same); see conf/split/.

    derenderer: whose estimates of AB and C are seen instead of the true positions, or None. estimated: the splits of
    which only the estimates are seen. oracle: name and settings of the one whose forecasts come with the test split, or None.
    """

    def __init__(
        self,
        *,
        scenario: Scenario,
        split: Split,
        size: Size,
        seed: int,
        data_dir: Path,
        batch_size: int,
        workers: int,
        derenderer: Sees | None = None,
        estimated: tuple[str, ...] = (),
        oracle: tuple[str, OracleSettings] | None = None,
    ) -> None:
        super().__init__()
        split.check_scenario(scenario)
        self.scenario, self.split, self.data_dir = scenario, split, data_dir
        self.derenderer, self.estimated, self.oracle = derenderer, estimated, oracle
        self.batch_size, self.workers = batch_size, workers
        self.train_spec = DatasetSpec(scenario, split.train.num_objects, size, seed)
        self.test_spec = DatasetSpec(scenario, split.test.num_objects, size, seed)

    @property
    def dataset_ids(self) -> list[str]:
        """Datasets this split reads: the training one first, then the test one if it is another."""
        return list(dict.fromkeys([self.train_spec.id, self.test_spec.id]))

    @property
    def training_depends_on(self) -> list[Any]:
        """What the training batches are a function of."""
        seen = self.derenderer.name if self.derenderer and "train" in self.estimated else None
        return [self.train_spec.id, asdict(self.split.train), asdict(self.scenario.task), seen]

    @property
    def mean_position(self) -> Tensor:
        """(3,) metres: mean true position of the objects in C over the training split."""
        batch = self.train.batch
        return batch.target_initial[batch.target_presence].mean(dim=0)

    def prepare_data(self) -> None:
        """Generate what is missing."""
        for spec in (self.train_spec, self.test_spec):
            generation.ensure(States(spec, self.data_dir), workers=self.workers)
            estimates = self._estimates(spec)
            if estimates and not estimates.is_finished():
                generation.ensure(estimates.images, workers=self.workers)
                generation.ensure(estimates, workers=self.workers)
        if forecasts := self._forecasts():
            generation.ensure(forecasts, workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Load all splits; confounders are standardised over the training one."""
        if hasattr(self, "train"):
            return
        specs = {spec.id: spec for spec in (self.train_spec, self.test_spec)}
        arrays = {name: self._load(spec) for name, spec in specs.items()}
        chosen = {split: self._select(arrays, split) for split in SPLITS}
        batches = {split: to_batch(chosen[split], self.scenario) for split in SPLITS}
        statistics = confounder_statistics(batches["train"])
        seen = {split: standardise(batch, statistics) for split, batch in batches.items()}
        for split in self.estimated:
            seen[split] = with_estimates(seen[split], chosen[split], self.scenario)
        seen["test"] = seen["test"]._replace(**self._forecast(arrays[self.test_spec.id]))
        self.train, self.val, self.test = (CounterfactualDataset(seen[split]) for split in SPLITS)

    def train_dataloader(self) -> DataLoader[Batch]:
        return self.train.loader(self.batch_size, shuffle=True)

    def val_dataloader(self) -> DataLoader[Batch]:
        return self.val.loader(self.batch_size, shuffle=False)

    def test_dataloader(self) -> DataLoader[Batch]:
        return self.test.loader(self.batch_size, shuffle=False)

    def _select(self, arrays: dict[str, dict[str, np.ndarray]], split: str) -> dict[str, np.ndarray]:
        spec, part = self._spec_of(split), self.split.test if split == "test" else self.split.train
        chosen = select(arrays[spec.id], part, split)
        if not len(chosen["split"]):
            raise CophyError(f"split={self.split.name} leaves no {split} experiments of {spec.id}: take a larger size=")
        return chosen

    def _spec_of(self, split: str) -> DatasetSpec:
        return self.test_spec if split == "test" else self.train_spec

    def _estimates(self, spec: DatasetSpec) -> Estimates | None:
        """Those of a dataset, if one of its splits is seen through them."""
        if self.derenderer is None or spec.id not in {self._spec_of(split).id for split in self.estimated}:
            return None
        return Estimates(Images(States(spec, self.data_dir), self.derenderer.render), self.derenderer)

    def _forecasts(self) -> OracleForecasts | None:
        return OracleForecasts(States(self.test_spec, self.data_dir), self.oracle[1]) if self.oracle else None

    def _forecast(self, arrays: dict[str, np.ndarray]) -> dict[str, Tensor]:
        """The oracle's fields of the test batch."""
        if (forecasts := self._forecasts()) is None or self.oracle is None:
            return {}
        stored, tested = forecasts.load(), selected(arrays, self.split.test, "test")
        rows = np.searchsorted(stored["experiment"], np.flatnonzero(tested))
        return {
            f"oracle_{what}": torch.from_numpy(stored[f"{self.oracle[0]}_{what}"][rows])
            for what in ("position", "stable")
        }

    def _load(self, spec: DatasetSpec) -> dict[str, np.ndarray]:
        estimates = self._estimates(spec)
        return States(spec, self.data_dir).load() | (estimates.load() if estimates else {})
