"""docs/guides/extending.md, followed to the letter: a model in one Python file and one YAML file, in a folder of its own."""

import json
import re
from pathlib import Path

import pytest

from tests.commands import run_apart
from tests.conftest import ROOT


def blocks(language: str) -> list[str]:
    """The code blocks of the page."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "docs" / "guides" / "extending.md").read_text(), re.DOTALL)


@pytest.mark.slow
def test_the_model_of_the_page_trains_and_appears_in_the_report(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python, yaml = blocks("python"), blocks("yaml")
    files = {
        **{"drift.py": python[0], "my_losses/late.py": python[1], "my_metrics/heights.py": python[2]},
        **{"conf/model/drift.yaml": yaml[0], "conf/loss/late.yaml": yaml[1], "conf/metrics/final_height.yaml": yaml[2]},
        "conf/split/heavy_to_light.yaml": yaml[4],
    }
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)

    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    row = tmp_path / "outputs/collision/all/drift/full/ground_truth/seed0+size-tiny+max_epochs-2"
    train = (
        *("train", "--config-dir", tmp_path / "conf", "scenario=collision", "model=drift", "size=tiny"),
        *(f"data_dir={tiny_data}", "trainer.max_epochs=2", f"source.outputs={tmp_path / 'outputs'}"),
    )
    run_apart(*train)
    metrics = json.loads((row / "metrics.json").read_text())
    assert metrics["model"] == "drift"
    assert metrics["metrics"]["mse"] > 0
    run_apart(*train, "split=heavy_to_light", "loss=late", "metrics=final_height")
    row = tmp_path / "outputs/collision/heavy_to_light/drift/full/ground_truth/seed0+size-tiny+loss-late+max_epochs-2"
    metrics = json.loads((row / "metrics.json").read_text())
    assert metrics["intervals"]["final_height"][0] <= metrics["metrics"]["final_height"]
    assert metrics["num_train"] < 34  # of all
    run_apart("report", f"outputs={tmp_path / 'outputs'}")
    for name in ("tables.md", "tables.tex"):
        assert "drift" in (tmp_path / "outputs" / "report" / name).read_text()
