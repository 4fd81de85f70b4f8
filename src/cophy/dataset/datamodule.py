"""LightningDataModule over generated or released data: makes what is missing, holds everything in memory."""

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
from cophy.dataset.external import ExternalStates
from cophy.dataset.images import Images
from cophy.dataset.oracles import OracleForecasts, OracleSettings
from cophy.dataset.source import Source, pictures_of
from cophy.dataset.spec import Size
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.types import Batch


class CounterfactualDataModule(L.LightningDataModule):
    """Trains and validates on one part of the data, tests on another (or the same); see conf/split/.

    derenderer: whose estimates of AB and C are seen instead of the true positions, or None. estimated: the splits of
    which only the estimates are seen. needs_confounders: whether the true ones are given or learnt, not only estimated. oracle:
    name and settings of the one whose forecasts come with the test split, or None.
    """

    def __init__(
        self,
        *,
        scenario: Scenario,
        split: Split,
        size: Size,
        seed: int,
        data_dir: Path,
        source: Source,
        batch_size: int,
        workers: int,
        derenderer: Sees | None = None,
        estimated: tuple[str, ...] = (),
        needs_confounders: bool = False,
        oracle: tuple[str, OracleSettings] | None = None,
    ) -> None:
        super().__init__()
        split.check_scenario(scenario)
        self.scenario, self.split = scenario, split
        self.derenderer, self.estimated, self.oracle = derenderer, estimated, oracle
        self.needs_confounders = needs_confounders
        self.batch_size, self.workers = batch_size, workers
        self.train_states, self.test_states = (
            source.states(scenario, part.num_objects, split=split, size=size, seed=seed, data_dir=data_dir)
            for part in (split.train, split.test)
        )

    @property
    def dataset_ids(self) -> list[str]:
        """Datasets this split reads: the training one first, then the test one if it is another."""
        return list(dict.fromkeys([self.train_states.id, self.test_states.id]))

    @property
    def training_depends_on(self) -> list[Any]:
        """What the training batches are a function of."""
        seen = self.derenderer.name if self.derenderer and "train" in self.estimated else None
        task = {key: value for key, value in asdict(self.scenario.task).items() if key != "splits"}  # names, no data
        return [self.train_states.id, asdict(self.split.train), task, seen]

    @property
    def mean_position(self) -> Tensor:
        """(3,) metres: mean true position of the objects in C over the training split."""
        batch = self.train.batch
        return batch.target_initial[batch.target_presence].mean(dim=0)

    def prepare_data(self) -> None:
        """Generate what is missing, or index what was released."""
        for states in (self.train_states, self.test_states):
            generation.ensure(states, workers=self.workers)
            estimates = self._estimates(states)
            if estimates and not estimates.is_finished():
                if isinstance(estimates.images, Images):
                    generation.ensure(estimates.images, workers=self.workers)
                generation.ensure(estimates, workers=self.workers)
        if forecasts := self._forecasts():
            generation.ensure(forecasts, workers=self.workers)

    def setup(self, stage: str | None = None) -> None:
        """Load all splits; confounders are standardised over the training one."""
        if hasattr(self, "train"):
            return
        sets = {states.id: states for states in (self.train_states, self.test_states)}
        arrays = {name: self._load(states) for name, states in sets.items()}
        chosen = {split: self._select(arrays, split) for split in SPLITS}
        batches = {split: to_batch(chosen[split], self.scenario) for split in SPLITS}
        self.knows_confounders = not any(batch.confounders.isnan().any() for batch in batches.values())
        if self.needs_confounders and not self.knows_confounders:
            raise CophyError(
                f"{self.train_states.directory} does not tell all true confounders, which this row needs: it runs on other data"
            )
        statistics = confounder_statistics(batches["train"])
        seen = {split: standardise(batch, statistics) for split, batch in batches.items()}
        for split in self.estimated:
            seen[split] = with_estimates(seen[split], chosen[split], self.scenario)
        self.test_pairs = chosen["test"]["twin"]
        seen["test"] = seen["test"]._replace(**self._forecast(arrays[self.test_states.id]))
        self.train, self.val, self.test = (CounterfactualDataset(seen[split]) for split in SPLITS)

    def train_dataloader(self) -> DataLoader[Batch]:
        return self.train.loader(self.batch_size, shuffle=True)

    def val_dataloader(self) -> DataLoader[Batch]:
        return self.val.loader(self.batch_size, shuffle=False)

    def test_dataloader(self) -> DataLoader[Batch]:
        return self.test.loader(self.batch_size, shuffle=False)

    def _select(self, arrays: dict[str, dict[str, np.ndarray]], split: str) -> dict[str, np.ndarray]:
        states, part = self._states_of(split), self.split.test if split == "test" else self.split.train
        chosen = select(arrays[states.id], part, split)
        if not len(chosen["split"]):
            remedy = "take a larger size=" if isinstance(states, States) else f"see {states.directory}"
            raise CophyError(f"split={self.split.name} leaves no {split} experiments of {states.id}: {remedy}")
        return chosen

    def _states_of(self, split: str) -> States | ExternalStates:
        return self.test_states if split == "test" else self.train_states

    def _estimates(self, states: States | ExternalStates) -> Estimates | None:
        """Those of a dataset, if one of its splits is seen through them."""
        if self.derenderer is None or states.id not in {self._states_of(split).id for split in self.estimated}:
            return None
        return Estimates(pictures_of(states, self.derenderer.render), self.derenderer)

    def _forecasts(self) -> OracleForecasts | None:
        if self.oracle is None:
            return None
        if isinstance(self.test_states, ExternalStates):
            raise CophyError("oracles simulate generated data: released data lack what a simulation starts from")
        return OracleForecasts(self.test_states, self.oracle[1])

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

    def _load(self, states: States | ExternalStates) -> dict[str, np.ndarray]:
        arrays, estimates = states.load(), self._estimates(states)
        if estimates is None:
            return arrays
        if "clip" in arrays and not arrays["clip"].all():
            missing = (~arrays["clip"].all(axis=1)).sum()
            raise CophyError(f"{missing} experiments of {states.id} have no RGB clips to estimate positions from")
        rows = arrays.get("experiment", slice(None))
        return arrays | {name: array[rows] for name, array in estimates.load().items()}
