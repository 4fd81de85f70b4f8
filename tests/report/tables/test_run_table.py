"""Runs as a table."""

import json
from pathlib import Path

import pandas as pd

from cophy.report.tables.run_table import read_runs, summary
from tests.report.lines import measured, run


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


def test_only_runs_in_their_own_place_are_read(tmp_path: Path) -> None:
    content = run("cophynet") | {"dataset_ids": ["3-x"], "metrics": {"mse": 0.2}, "intervals": {"mse": [0.1, 0.3]}}
    del content["error"], content["directory"]
    place = Path("blocktower/3to3/cophynet/full/ground_truth/seed0")
    for directory in (place, Path("demo") / place, Path("blocktower/3to3/in/full/ground_truth/seed0")):
        (tmp_path / directory / ".hydra").mkdir(parents=True)
        config = (
            "trainer: {max_epochs: 40}\nmodel: {a: 1}\nscenario: {task: {metric_dims: 3}}\nsplit: {epochs_factor: 2}\n"
        )
        (tmp_path / directory / ".hydra" / "config.yaml").write_text(config)
        (tmp_path / directory / "metrics.json").write_text(json.dumps(content))
    runs = read_runs(tmp_path, lambda names: {"model": {"a": 1}})
    assert list(runs["directory"]) == [tmp_path / place]
    assert runs.iloc[0][["mse", "mse_low", "mse_high", "epochs"]].tolist() == [0.2, 0.1, 0.3, 80]
    assert read_runs(tmp_path, lambda names: {"model": {"a": 2}}).empty
