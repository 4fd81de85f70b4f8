"""Runs as a table."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cophy.errors import CophyError
from cophy.report.runs import MAX_BYTES, of_largest_size, of_seeds, read_runs, summary
from cophy.report_choices import ComposedChoices
from tests.report.lines import measured, run
from tests.report.stored_runs import CONFIG, PLACE, content, leave


def test_the_summary_tells_the_cost() -> None:
    runs = pd.DataFrame([measured("mse", 0.2, "cophynet"), run("npe", error="boom")])
    line = summary(runs).iloc[0]
    assert (line["run"], line["training (s)"], line["mse"]) == (
        "blocktower 3to3 cophynet full ground_truth small",
        "100",
        "0.200",
    )
    assert summary(runs).iloc[1]["seeds"] == "0 (1 failed)"
    assert summary(pd.DataFrame()).empty


def test_the_summary_averages_seeds_alone() -> None:
    seeds = [measured("mse", value, "cophynet", seed=seed) for seed, value in enumerate((0.2, 0.3))]
    longer = [measured("mse", 0.1, "cophynet", epochs=120)]
    lines = summary(pd.DataFrame(seeds + longer)).set_index("epochs")
    assert lines["mse"].to_dict() == {"40": "0.250 ± 0.071", "120": "0.100"}
    assert lines["seeds"].to_dict() == {"40": "2", "120": "1"}


def test_runs_that_differ_in_their_seed_alone_may_be_averaged() -> None:
    seen = [
        measured("mse", 0.2, "cophynet", seed=seed, derenderer=name) for seed, name in ((0, "b"), (1, "a"), (2, "a"))
    ]
    assert of_seeds(pd.DataFrame(seen))["seed"].tolist() == [1, 2]
    both = pd.DataFrame([*seen, measured("mse", 0.1, "cophynet", seed=5, epochs=120, derenderer="b")])
    assert of_seeds(both)["seed"].tolist() == [5]
    sizes = pd.DataFrame(
        [measured("mse", 0.2, "in", size=name, num_train=n) for name, n in (("paper", 900), ("12k", 400))]
    )
    assert of_largest_size(sizes)["size"].tolist() == ["paper"]


def test_what_was_refused_before_it_began_does_not_count(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    for seed, begun in enumerate((True, False)):
        directory = tmp_path / PLACE.with_name(f"seed{seed}")
        directory.mkdir(parents=True)
        names = run("cophynet", seed=seed) | {"variant": "", "error": "boom", "has_begun": begun}
        (directory / "failure.json").write_text(json.dumps({**names, "directory": ""}))
    assert read_runs(tmp_path, lambda names: {})["seed"].tolist() == [0]
    assert "refused before they began, and do not count: 1." in caplog.text


def test_only_runs_in_their_own_place_are_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    for directory in (PLACE, Path("demo") / PLACE, Path("blocktower/3to3/in/full/ground_truth/seed0")):
        leave(tmp_path / directory, json.dumps(content()))
    runs = read_runs(tmp_path, lambda names: {"model": {"a": 1}})
    assert list(runs["directory"]) == [tmp_path / PLACE]
    assert "do not lie where train.py puts them (hydra.run.dir=), and are not read: 1." in " ".join(caplog.text.split())
    assert runs.iloc[0][["mse", "mse_low", "mse_high", "epochs"]].tolist() == [0.2, 0.1, 0.3, 80]
    assert read_runs(tmp_path, lambda names: {"model": {"a": 2}}).empty


def test_a_run_on_other_data_than_its_names_stand_for_fills_no_table(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for seed, dataset in enumerate(("3-x", "3-old")):
        leave(tmp_path / PLACE.with_name(f"seed{seed}"), json.dumps(content(seed=seed, dataset_ids=[dataset])))
    assert read_runs(tmp_path, lambda names: {"dataset_ids": ["3-x"]})["seed"].tolist() == [0]
    assert "(dataset_ids=['3-old']): blocktower 3to3 cophynet." in " ".join(caplog.text.split())


def test_names_stand_for_the_data_that_are_generated_today() -> None:
    names = {"scenario": "blocktower", "split": "4to3", "model": "in", "ablation": "full", "size": "tiny"}
    generated = ComposedChoices("generated", Path("data"))
    ids = [generated.dataset("blocktower", count, "tiny").id for count in (4, 3)]
    assert generated.keys_of(names)["dataset_ids"] == ids
    assert generated.keys_of(names | {"split": "4to4"})["dataset_ids"] == ids[:1]
    assert "dataset_ids" not in generated.keys_of(names | {"model": "derenderer"})
    assert "dataset_ids" not in ComposedChoices("cophy", Path("data")).keys_of(names | {"size": "cophy"})
    with pytest.raises(CophyError, match="nowhere"):
        generated.keys_of(names | {"size": "nowhere"})


STRANGE = {
    "no JSON": "{",
    "nested deeply": "[" * 100_000,
    "a list": "[]",
    "many digits": json.dumps(content()).replace("0.2", "1" + "0" * 400, 1),
    "a text for a number": json.dumps(content(metrics={"mse": "0.2"})),
    "NaN": json.dumps(content(metrics={"mse": math.nan})),
    "infinite": json.dumps(content(metrics={"mse": math.inf})),
    "negative": json.dumps(content(metrics={"mse": -1.0})),
    "no interval": json.dumps(content(intervals={})),
    "half an interval": json.dumps(content(intervals={"mse": [0.1]})),
    "no metrics": json.dumps(content(metrics=None)),
    "a path for a name": json.dumps(content(model="../../cophynet")),
    "datasets that are no names": json.dumps(content(dataset_ids=[1])),
    "too large": " " * (MAX_BYTES + 1),
}


@pytest.mark.parametrize("metrics", STRANGE.values(), ids=STRANGE.keys())
def test_a_strange_run_is_named_and_passed_over(tmp_path: Path, metrics: str, caplog: pytest.LogCaptureFixture) -> None:
    leave(tmp_path / PLACE, metrics)
    leave(tmp_path / PLACE.with_name("seed1"), json.dumps(content(seed=1)))
    assert read_runs(tmp_path, lambda names: {})["seed"].tolist() == [1]
    assert f"{PLACE}/metrics.json" in caplog.text


@pytest.mark.parametrize(
    "config", ["a: &a [1]\nb: *a\n" + CONFIG, "[]", "trainer: 3", ": : :", "scenario: {task: {metric_dims: x}}"]
)
def test_a_strange_configuration_is_named_and_passed_over(
    tmp_path: Path, config: str, caplog: pytest.LogCaptureFixture
) -> None:
    leave(tmp_path / PLACE, json.dumps(content()), config)
    assert read_runs(tmp_path, lambda names: {}).empty
    assert f"{PLACE}/metrics.json is skipped" in caplog.text


def pickled() -> dict[str, Any]:
    return {"position": np.array([print], dtype=object)}


@pytest.mark.parametrize(
    "changes",
    [
        {"position": np.zeros((4, 5, 3))},
        {"position": np.full((4, 5, 3, 3), np.nan, "f4")},
        {"pair": np.zeros(3)},
        {"presence": np.ones((4, 4), bool)},
        {"target": np.zeros(3)},
        pickled(),
    ],
    ids=["shape", "NaN", "pair", "presence", "target", "pickled"],
)
def test_strange_predictions_are_named_and_their_run_passed_over(
    tmp_path: Path, changes: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    leave(tmp_path / PLACE, json.dumps(content()))
    path = tmp_path / PLACE / "predictions.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez_compressed(path, **(arrays | changes))
    assert read_runs(tmp_path, lambda names: {}).empty
    assert "predictions.npz is missing or damaged" in caplog.text
    path.unlink()
    assert read_runs(tmp_path, lambda names: {}).empty


def test_what_cannot_be_read_is_counted(tmp_path: Path) -> None:
    assert read_runs(tmp_path, lambda names: {}).attrs["skipped"] == 0
    broken = tmp_path / "balls" / "4to4" / "in" / "full" / "ground_truth" / "seed0" / "metrics.json"
    broken.parent.mkdir(parents=True)
    broken.write_text("{}")
    assert read_runs(tmp_path, lambda names: {}).attrs["skipped"] == 1
