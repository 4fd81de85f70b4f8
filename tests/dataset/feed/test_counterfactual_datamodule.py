"""Experiments as predictors are fed them."""

from pathlib import Path

import pytest
import torch

from cophy.config import settings
from cophy.dataset import generation
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.estimates import Estimates
from cophy.dataset.features import DeclaredInputs, to_batch
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.types import CONFOUNDERS, map_tensors
from tests.conftest import tiny_spec
from tests.dataset.pictures.guess import Guess

OPTIONAL = ("confounders", "object_type", "pose")


def fed(
    data_dir: Path, declared: DeclaredInputs | None = None, num_experiments: int | None = None
) -> CounterfactualDataModule:
    states = States(tiny_spec("collision"), data_dir)
    split = settings("train", "scenario=collision").split
    data = CounterfactualDataModule(
        split,
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
    rows = data.split.train.select_split(stored, "train")
    expected = to_batch({name: array[rows] for name, array in stored.items()}, data.scenario)
    map_tensors(same, data.train.batch, expected)


@pytest.mark.parametrize("name", [None, *OPTIONAL])
def test_a_network_is_given_what_its_configuration_declares_and_nothing_else(name: str | None, tiny_data: Path) -> None:
    """The true confounders above all: elsewhere they are not in what it gets."""
    data = fed(tiny_data, None if name is None else DeclaredInputs(**{name: True}))
    for loader in (data.train_dataloader(), data.val_dataloader(), data.test_dataloader()):
        for batch in loader:
            assert [each for each in OPTIONAL if getattr(batch.inputs, each) is not None] == ([name] if name else [])


def test_looks_are_those_of_the_experiment_that_they_come_with(tiny_data: Path) -> None:
    """Types, poses and the confounders agree about which objects are cylinders."""
    data = fed(tiny_data, DeclaredInputs(confounders=True, object_type=True, pose=True))
    inputs = data.train.batch.inputs
    assert (inputs.object_type.sum(dim=-1) == inputs.observed_presence).all()
    cylinder = inputs.object_type[..., 2] == 1
    assert (inputs.pose.any(dim=-1) == cylinder).all()
    confounder = inputs.confounders[..., CONFOUNDERS.index("cylinder")]  # standardised
    assert torch.equal(confounder > 0, cylinder)


def test_a_learning_curve_trains_on_the_first_experiments_and_tests_on_all(tiny_data: Path) -> None:
    every, few = fed(tiny_data), fed(tiny_data, num_experiments=10)
    assert torch.equal(few.train.batch.inputs.observed, every.train.batch.inputs.observed[:10])
    assert torch.equal(few.train.batch.targets.pair, every.train.batch.targets.pair[:10])
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
    """Of towers of four only the test experiments are read."""
    asked: dict[int, str] = {}
    monkeypatch.setattr(generation, "ensure", lambda states, workers: None)
    monkeypatch.setattr(
        Estimates, "ensure", lambda self, workers: asked.update({self.spec.num_objects: self.needed.name})
    )
    CounterfactualDataModule(
        settings("train", "split=3to4").split,
        train_set=States(tiny_spec("blocktower", 3), tmp_path),
        test_set=States(tiny_spec("blocktower", 4), tmp_path),
        batch_size=8,
        workers=1,
        derenderer=Guess(),
        estimated=estimated,
    ).prepare_data()
    assert asked == looked_at
