"""Whole runs in every precision: training, figures, test, probe and results."""

import json
from pathlib import Path

import pytest

from tests.commands import train
from tests.conftest import quick_first


@pytest.mark.parametrize("precision", quick_first(["bf16-mixed", "bf16-true", "16-mixed", "64-true"]))
@pytest.mark.filterwarnings("ignore:You passed .*16-mixed.*")  # a CPU takes bfloat16 instead
def test_a_run_leaves_its_results_in_every_precision(precision: str, tiny_data: Path, tmp_path: Path) -> None:
    train("scenario=collision", f"trainer.precision={precision}", f"hydra.run.dir={tmp_path}", data=tiny_data)
    metrics = json.loads((tmp_path / "metrics.json").read_text())["metrics"]
    assert metrics["mse"] > 0
    assert 0 <= metrics["probe_accuracy"] <= 1
