"""The script that keeps results keeps what belongs together."""

import importlib
import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from cophy.scoring import Scores
from tests.report.lines import scores_of_mse
from tests.report.stored_runs import PLACE, content, leave

SCRIPTS = Path(__file__).parents[2] / "benchmarks" / "results"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """benchmarks/results/keep_results.py."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("keep_results")


def test_a_run_keeps_the_commit_that_made_it(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, metrics = tmp_path / "table.csv", tmp_path / PLACE / "metrics.json"
    leave(metrics.parent, json.dumps(content(variant="")))
    for commit, seconds, kept in (("one", 100.0, "one"), ("two", 100.0, "one"), ("three", 90.0, "three")):
        monkeypatch.setattr(script, "committed", lambda name=commit: name)
        metrics.write_text(json.dumps(content(variant="", training_seconds=seconds)))
        script.main(tmp_path, table)
        assert pd.read_csv(table)["commit"].tolist() == [kept]


def test_shares_need_both_oracles_and_outlive_their_runs(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair, mse = np.arange(40) // 2, {"cophynet": 2.0, "oracle_feedforward": 5.0, "oracle_counterfactual": 1.0}
    names = {"scenario": "balls", "split": "4to4", "test_dataset": "4-x", "size": "paper"}
    runs = pd.DataFrame([{"model": model, "variant": "+size-paper"} | names for model in mse])
    own = runs.iloc[1:].assign(variant="+noise-1+size-paper")
    elsewhere, split = runs[:1].assign(test_dataset="4-y"), runs[:1].assign(split="3to4")

    def scores(run: dict[str, str]) -> Scores:
        value = mse[run["model"]] + 7.0 * ("noise" in run["variant"])
        return scores_of_mse(np.full(40, value), pair)

    def shares_of(*parts: pd.DataFrame) -> list[list[float]]:
        found = pd.concat(parts, ignore_index=True)
        shares: list[list[float]] = script.shares(found, script.errors_of_oracles(found, tmp_path / "oracles.csv"))
        return shares

    monkeypatch.setattr(script, "stored_scores", scores)
    assert np.isnan(shares_of(runs[:1], own)[0][0])  # oracles with settings of their own give no share
    assert np.isnan(shares_of(runs[:2])[0][0])
    assert shares_of(runs, own)[0] == pytest.approx([0.75] * 3)
    assert shares_of(runs[:1])[0] == pytest.approx([0.75] * 3)  # their errors are kept
    assert shares_of(split)[0] == pytest.approx([0.75] * 3)  # another split with the same test data
    assert np.isnan(shares_of(elsewhere)[0][0])


def test_a_de_renderer_is_kept_beside_predictors(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, "committed", lambda: "one")
    for model, error in (
        ("derenderer", 0.0),
        ("cophynet", 0.5),
        ("oracle_feedforward", 1.0),
        ("oracle_counterfactual", 0.0),
    ):
        place = tmp_path / PLACE.parents[3] / model / PLACE.relative_to(PLACE.parents[2])
        leave(place, json.dumps(content(model=model, variant="")), error=error)
        if model == "derenderer":
            (place / "predictions.npz").unlink()  # it leaves none
    script.main(tmp_path, tmp_path / "table.csv")
    for _ in range(2):
        kept = pd.read_csv(tmp_path / "table.csv").set_index("model")["share"]
        assert kept["cophynet"] == 0.75
        assert np.isnan(kept["derenderer"])
        for path in tmp_path.rglob("oracle_*"):  # shares outlive the runs of the oracles
            shutil.rmtree(path)
        script.main(tmp_path, tmp_path / "table.csv")
