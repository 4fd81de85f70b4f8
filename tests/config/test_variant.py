"""What a run changes beyond its names."""

import json
import re
from pathlib import Path

import pytest

from cophy.config import LONGEST, changes, composed, variant
from tests.commands import train

PATIENT = "training.callbacks.early_stopping.patience=20"


def variant_of(*overrides: str) -> str:
    config = composed("train", *overrides, return_hydra_config=True)
    return variant(changes(config, config.hydra))


@pytest.mark.parametrize(
    "named", [(), ("scenario=balls", "split=4to3"), ("+row=in_sup",), ("ablation=mlp", "seed=3"), ("size=small",)]
)
def test_a_named_row_at_the_default_size_changes_nothing(named: tuple[str, ...]) -> None:
    assert variant_of(*named) == ""


def test_what_changes_no_result_is_not_in_it() -> None:
    without_effect = ("trainer.devices=2", "data_dir=elsewhere", "workers=4", "trainer.enable_progress_bar=false")
    assert variant_of(*without_effect, "model.hidden_dim=32") == ""  # the last is the default


def test_choices_come_first_then_keys_in_their_order() -> None:
    changed = ("model.hidden_dim=8", "size=12k", "trainer.max_epochs=3", "data_seed=1")
    assert variant_of(*changed) == variant_of(*changed[::-1]) == "+size-12k+data_seed-1+hidden_dim-8+max_epochs-3"
    assert variant_of("scenario=collision", "confounders=text") == "+confounders-text"
    assert variant_of("split.epochs_factor=3") == "+epochs_factor-3"
    assert variant_of("scenario.confounders.mass=[1,2]") == "+mass-1.0_2.0"
    assert variant_of("training.learning_rate=0.002") == "+learning_rate-0.002"  # which the optimiser repeats
    assert variant_of("training.optimizer.lr=0.002") == "+lr-0.002"
    assert variant_of("optimizer=adamw", "schedule=constant") == "+optimizer-adamw+schedule-constant"
    stopping = variant_of("callbacks=early_stopping")
    assert re.fullmatch(r"\+early_stopping-\w{6}", stopping)
    assert stopping == variant_of("callbacks=[early_stopping]") != variant_of("callbacks=early_stopping", PATIENT)
    assert variant_of("loss=huber", "training.loss.delta=2") == "+loss-huber+delta-2"
    assert variant_of("logger=[tensorboard,csv]") == ""
    assert variant_of("+metrics.height._target_=mine.height") == ""  # of a test, which is always repeated
    assert variant_of("+trainer.accumulate_grad_batches=2") == "+accumulate_grad_batches-2"


def test_what_changes_the_data_is_in_it() -> None:
    assert variant_of("model=derenderer", "render.backend=egl") == "+backend-egl"
    assert variant_of("source=cophy", "source.root=/data", "source.splits=/lists") == "+splits-lists"


def test_keys_of_the_same_last_word_are_told_apart() -> None:
    both = variant_of("split.train.num_objects=4", "split.test.num_objects=4")
    assert both == "+split.test.num_objects-4+split.train.num_objects-4"


def test_a_long_one_ends_with_a_hash_of_all_of_it() -> None:
    many = [f"scenario.{key}=0.123456" for key in ("min_margin", "fallen_distance", "max_level_offset", "block_size")]
    found = [variant_of(*many, f"training.learning_rate={rate}", "training.batch_size=32") for rate in (0.1, 0.2)]
    assert found[0] != found[1]
    assert all(len(each) <= LONGEST + 1 for each in found)


@pytest.mark.slow
def test_every_value_of_a_sweep_has_a_directory_and_is_trained_once(tiny_data: Path, tmp_path: Path) -> None:
    sweep = (
        "-m",
        "scenario=collision",
        "model.hidden_dim=8,16",
        "trainer.max_epochs=1,2",
        f"hydra.sweep.dir={tmp_path}",
    )
    assert "already trained" not in train(*sweep, data=tiny_data)
    results = {path.parent.name: json.loads(path.read_text()) for path in tmp_path.rglob("metrics.json")}
    assert set(results) == {f"seed0+size-tiny+hidden_dim-{dim}+max_epochs-{n}" for dim in (8, 16) for n in (1, 2)}
    assert len({content["metrics"]["mse"] for content in results.values()}) == 4
    assert train(*sweep, data=tiny_data).count("already trained") == 4
    for path in tmp_path.rglob("metrics.json"):
        assert json.loads(path.read_text())["metrics"] == results[path.parent.name]["metrics"]
