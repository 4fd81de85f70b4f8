"""Batches of experiments: their order, their content, and how devices share them."""

from itertools import chain
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, TensorDataset

from cophy.config import settings
from cophy.dataset import generation
from cophy.dataset.datamodules import (
    ONE_DEVICE,
    CounterfactualDataModule,
    CounterfactualDataset,
    DeviceShare,
    ordered_batches,
    shuffled_batches,
)
from cophy.dataset.estimates import Estimates
from cophy.dataset.features import to_batch
from cophy.dataset.splits import SPLITS, Part, Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.types import CONFOUNDERS, Batch, map_tensors
from tests.conftest import tiny_spec
from tests.dataset.copies import SPEC, MeanColor

ITEMS = TensorDataset(torch.arange(22))
SPLIT = settings("train", "scenario=collision").split
OPTIONAL = ("confounders", "object_type", "pose")


def epoch_of(batches: dict[str, Any], epoch: int) -> list[list[int]]:
    batches["sampler"].set_epoch(epoch)
    return [batch.tolist() for (batch,) in DataLoader(ITEMS, **batches)]


def test_an_epoch_has_an_order_of_its_own_that_comes_again() -> None:
    first, again = (epoch_of(shuffled_batches(ITEMS, 8, seed=1, share=ONE_DEVICE), 3) for _ in range(2))
    assert first == again
    assert sorted(chain(*first)) == list(range(22))
    assert [len(batch) for batch in first] == [8, 8, 6]
    assert epoch_of(shuffled_batches(ITEMS, 8, seed=1, share=ONE_DEVICE), 4) != first
    assert epoch_of(shuffled_batches(ITEMS, 8, seed=2, share=ONE_DEVICE), 3) != first


def test_devices_share_the_batches_of_one() -> None:
    whole = epoch_of(shuffled_batches(ITEMS, 8, seed=1, share=ONE_DEVICE), 2)
    shares = [epoch_of(shuffled_batches(ITEMS, 8, seed=1, share=DeviceShare(2, rank)), 2) for rank in range(2)]
    assert [[batch[rank::2] for batch in whole] for rank in range(2)] == shares
    with pytest.raises(CophyError, match="cannot be shared by 3 devices"):
        shuffled_batches(ITEMS, 8, seed=1, share=DeviceShare(3, 0))


@pytest.mark.parametrize("devices", [1, 2, 3, 4])
@pytest.mark.parametrize("groups", [np.repeat(np.arange(11), 2), np.arange(22), np.repeat([3, 4, 5, 6], [2, 1, 2, 17])])
def test_in_order_every_item_is_met_once_and_twins_together(groups: np.ndarray, devices: int) -> None:
    shares = [ordered_batches(groups, 4, DeviceShare(devices, rank)) for rank in range(devices)]
    batches = list(chain(*shares))
    assert list(chain(*batches)) == list(range(22))
    assert all(batches)
    assert len({len(share) for share in shares}) == 1  # devices wait for each other at every batch
    met = [set(groups[batch].tolist()) for batch in batches]
    assert not [one & other for n, one in enumerate(met) for other in met[n + 1 :] if one & other]


def test_fewer_groups_than_devices_are_refused() -> None:
    with pytest.raises(CophyError, match="cannot be shared by 3 devices"):
        ordered_batches(np.repeat([0, 1], 2), 4, DeviceShare(3, 0))


def test_a_loader_visits_every_experiment_once(tiny) -> None:
    spec, arrays = tiny
    data = CounterfactualDataset(to_batch(arrays, spec.scenario))
    batches = list(data.shuffled(16))
    assert [len(batch) for batch in batches] == [16, 16, 16]
    sums = torch.cat([batch.targets.position for batch in batches]).flatten(1).sum(dim=1)
    torch.testing.assert_close(sums.sort().values, data.batch.targets.position.flatten(1).sum(dim=1).sort().values)


class Recorder(L.LightningModule):
    """Trains nothing, and keeps which items it sees."""

    def __init__(self) -> None:
        super().__init__()
        self.automatic_optimization, self.seen = False, []

    def training_step(self, batch: Batch) -> None:
        self.seen.append(batch.targets.pair.tolist())

    def configure_optimizers(self) -> list[object]:
        return []


def test_overfit_batches_sees_the_same_items_in_every_epoch(tower_batch: Batch) -> None:
    module, quiet = Recorder(), dict.fromkeys(("logger", "enable_progress_bar", "enable_model_summary"), False)
    trainer = L.Trainer(overfit_batches=1, max_epochs=2, enable_checkpointing=False, accelerator="cpu", **quiet)
    with pytest.warns(UserWarning, match="turning off the train dataloader shuffling"):
        trainer.fit(module, CounterfactualDataset(tower_batch).shuffled(8))
    assert module.seen == [tower_batch.targets.pair[:8].tolist()] * 2


def fed(data_dir: Path, declared: tuple[str, ...] = (), num_experiments: int | None = None) -> CounterfactualDataModule:
    states = States(SPEC, data_dir)
    data = CounterfactualDataModule(
        SPLIT,
        train_set=states,
        test_set=states,
        batch_size=8,
        workers=1,
        declared=declared,
        num_experiments=num_experiments,
    )
    data.setup()
    return data


def test_a_split_is_made_of_what_is_stored_although_states_between_frames_are_dropped(tiny_data: Path) -> None:
    def same(had: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        assert torch.equal(had, wanted)
        return had

    data = fed(tiny_data)
    stored = data.train_set.load()
    rows = data.split.train.select_split(stored, "train", data.scenario)
    expected = to_batch({name: array[rows] for name, array in stored.items()}, data.scenario)
    map_tensors(same, data.train.batch, expected)


@pytest.mark.parametrize("name", [None, *OPTIONAL])
def test_a_network_is_given_what_its_configuration_declares_and_nothing_else(name: str | None, tiny_data: Path) -> None:
    """The true confounders above all: elsewhere they are not in what it gets."""
    data = fed(tiny_data, () if name is None else (name,))
    for loader in (data.train_dataloader(), data.val_dataloader(), data.test_dataloader()):
        for batch in loader:
            assert [each for each in OPTIONAL if getattr(batch.inputs, each) is not None] == ([name] if name else [])


def test_looks_are_those_of_the_experiment_that_they_come_with(tiny_data: Path) -> None:
    """Types, poses and the confounders agree about which objects are cylinders."""
    data = fed(tiny_data, OPTIONAL)
    inputs = data.train.batch.inputs
    assert (inputs.object_type.sum(dim=-1) == inputs.observed_presence).all()
    cylinder = inputs.object_type[..., 2] == 1
    assert (inputs.pose.any(dim=-1) == cylinder).all()
    confounder = inputs.confounders[..., CONFOUNDERS.index("cylinder")]  # standardised
    assert torch.equal(confounder > 0, cylinder)


def test_a_learning_curve_trains_on_whole_twin_pairs_and_tests_on_all(tiny_data: Path) -> None:
    every, few = fed(tiny_data), fed(tiny_data, num_experiments=10)
    pair, all_pairs = few.train.batch.targets.pair, every.train.batch.targets.pair
    assert pair.tolist() == all_pairs.sort().values[:10].tolist()
    assert torch.equal(pair[::2], pair[1::2])
    assert torch.equal(few.train.batch.inputs.observed[::2, 0], few.train.batch.inputs.observed[1::2, 0])  # A
    for split in ("val", "test"):
        assert torch.equal(getattr(few, split).batch.inputs.observed, getattr(every, split).batch.inputs.observed)
    with pytest.raises(CophyError, match=r"training\.num_experiments=1000: there are 34 to train on"):
        fed(tiny_data, num_experiments=1000)


@pytest.mark.parametrize(
    ("estimated", "looked_at"), [(SPLITS, {3: "inputs", 4: "test_inputs"}), (["test"], {4: "test_inputs"})]
)
def test_no_frames_are_drawn_that_nobody_sees(
    estimated: list[str], looked_at: dict[int, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For towers of four, only the test experiments are read."""
    requested: dict[int, str] = {}
    monkeypatch.setattr(generation, "ensure", lambda states, workers: None)
    monkeypatch.setattr(
        Estimates, "ensure", lambda self, workers: requested.update({self.spec.num_objects: self.needed.name})
    )
    CounterfactualDataModule(
        Split("3to4", Part(3), Part(4)),
        train_set=States(tiny_spec("blocktower", 3), tmp_path),
        test_set=States(tiny_spec("blocktower", 4), tmp_path),
        batch_size=8,
        workers=1,
        derenderer=MeanColor(),
        estimated=estimated,
    ).prepare_data()
    assert requested == looked_at
