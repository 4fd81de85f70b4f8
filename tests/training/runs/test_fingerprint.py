"""What makes two trainings the same."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cophy.config import composed, settings, to_plain
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.models.baselines import CopyC
from cophy.training import reuse
from cophy.training.checkpoints import Origin
from cophy.training.reuse import fingerprint
from cophy.training.trainer import with_epochs

PARTS = ("model", "training", "scenario", "split", "size", "data_seed", "positions", "num_objects", "render")
PLAIN = to_plain(composed("train"))
ORIGIN = Origin(**{part: PLAIN[part] for part in PARTS}, trained_on=["3-tiny"])


def fingerprint_of(origin: Origin = ORIGIN, seed: int = 0, **trainer: Any) -> str:
    return fingerprint(CopyC(), origin, {"trainer": PLAIN["trainer"] | trainer, "seed": seed, "threads": 1})


@pytest.mark.parametrize("changes", [{"enable_progress_bar": False}, {"limit_test_batches": 1}])
def test_what_changes_no_weight_does_not_count(changes: dict[str, Any]) -> None:
    assert fingerprint_of(**changes) == fingerprint_of()


def test_what_changes_weights_counts() -> None:
    others = [
        fingerprint_of(replace(ORIGIN, trained_on=["4-tiny"])),
        fingerprint_of(replace(ORIGIN, model={**ORIGIN.model, "hidden_dim": 8})),
        fingerprint_of(replace(ORIGIN, training={**ORIGIN.training, "learning_rate": 1.0})),
        fingerprint_of(seed=1),
        fingerprint_of(max_epochs=1),
    ]
    assert len({fingerprint_of(), *others}) == 6


def test_code_is_that_which_the_command_began_with(monkeypatch: pytest.MonkeyPatch) -> None:
    before = fingerprint_of()
    monkeypatch.setattr(Path, "read_bytes", lambda self: b"edited meanwhile")
    assert fingerprint_of() == before
    monkeypatch.setitem(reuse._CODE, next(iter(reuse._CODE)), b"other code")
    assert fingerprint_of() != before


def test_twice_the_epochs_are_another_training() -> None:
    doubled, without_limit = with_epochs(PLAIN["trainer"], 2), with_epochs({"max_epochs": -1}, 2)
    assert (doubled["max_epochs"], without_limit["max_epochs"]) == (2 * PLAIN["trainer"]["max_epochs"], -1)
    assert fingerprint_of(**doubled) == fingerprint_of(max_epochs=doubled["max_epochs"]) != fingerprint_of()


def training_of(split: str) -> str:
    """The fingerprint of training for a split of towers."""
    chosen = settings("train", "size=tiny", f"split={split}")
    states = States(DatasetSpec(chosen.scenario, 3, chosen.size, 0), Path("data"))
    data = CounterfactualDataModule(chosen.split, train_set=states, test_set=states, batch_size=2, workers=1)
    epochs = with_epochs(PLAIN["trainer"], chosen.split.epochs_factor)
    return fingerprint_of(replace(ORIGIN, trained_on=data.trained_on), **epochs)


def test_seen_and_unseen_configurations_are_tested_on_one_training() -> None:
    assert training_of("3to3_seen") == training_of("3to3_unseen") != training_of("3to3")


def test_what_is_only_tested_on_does_not_count() -> None:
    assert fingerprint_of(replace(ORIGIN, split={**ORIGIN.split, "name": "3to4"})) == fingerprint_of()
