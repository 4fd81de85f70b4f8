"""What makes two trainings the same."""

from dataclasses import replace
from typing import Any

import pytest

from cophy.app.composition import composed, to_plain
from cophy.models.baselines import CopyC
from cophy.training.runs.reuse import fingerprint
from cophy.training.trained.checkpoints import Origin

PARTS = ("model", "training", "scenario", "split", "size", "data_seed", "positions", "num_objects", "render")
PLAIN = to_plain(composed("train"))
ORIGIN = Origin(**{part: PLAIN[part] for part in PARTS}, trained_on=["3-tiny"])


def fingerprint_of(origin: Origin = ORIGIN, seed: int = 0, **trainer: Any) -> str:
    return fingerprint(CopyC(), origin, trainer=PLAIN["trainer"] | trainer, seed=seed, threads=1)


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


def test_what_is_only_tested_on_does_not_count() -> None:
    assert fingerprint_of(replace(ORIGIN, split={**ORIGIN.split, "name": "3to4"})) == fingerprint_of()
