"""What a run says at its end is what its metrics.json holds."""

import json
from pathlib import Path

import pytest

from cophy.report.paper_tables import published_mse
from cophy.report.run_summary import _with_interval
from tests.commands import train

ROW = ("scenario=collision",)


def line(printed: str, title: str) -> str:
    (found,) = [text for text in printed.splitlines() if text.strip().startswith(title)]
    return found.strip().removeprefix(title).strip()


def metrics_of(outputs: Path, model: str) -> dict[str, dict[str, float]]:
    (path,) = outputs.glob(f"collision/all/{model}/full/ground_truth/*/metrics.json")
    return dict(json.loads(path.read_bytes()))


def test_the_table_holds_the_numbers_of_metrics_json(tiny_data: Path, tmp_path: Path) -> None:
    arguments = (*ROW, f"source.outputs={tmp_path}")
    printed = {model: train(*arguments, f"model={model}", data=tiny_data) for model in ("copy_c", "copy_b")}
    found = {model: metrics_of(tmp_path, model) for model in printed}
    for model, text in printed.items():
        mse, (low, high) = found[model]["metrics"]["mse"], found[model]["intervals"]["mse"]
        assert low == high == mse  # tiny data have a single cluster
        assert line(text, "MSE, m²") == f"{mse:.4f}"
        assert line(text, "copy C: nothing moves") == f"{found['copy_c']['metrics']['mse']:.4f}"
        assert line(text, "copy B: the do-operation changes nothing") == f"{found['copy_b']['metrics']['mse']:.4f}"
        explained = found[model]["metrics"]["twin_difference_explained"]
        assert line(text, "Explained part of the twins' difference") == f"{explained:.1%}"
        assert f"{model} (full) on collision all, seed 0" in " ".join(text.split())
        assert f"Results: {tmp_path}" in text
        assert "Share" not in text
    assert line(printed["copy_c"], "the paper's number of this row, from more experiments") == "4.370"


def test_an_interval_is_printed_if_there_is_one() -> None:
    content = {"metrics": {"mse": 0.5, "share": 0.5}, "intervals": {"mse": [0.4, 0.6], "share": [0.25, 0.75]}}
    assert _with_interval(content, "mse") == "0.5000 [0.4000, 0.6000]"
    assert _with_interval(content, "share", ".1%") == "50.0% [25.0%, 75.0%]"


def test_a_limited_test_counts_and_compares_what_it_tested(tiny_data: Path, tmp_path: Path) -> None:
    limited = ("training.batch_size=2", "trainer.limit_test_batches=1", f"hydra.run.dir={tmp_path}")
    train("scenario=collision", "model=copy_b", *limited, data=tiny_data)
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert content["num_test"] == 2
    assert content["copies"]["copy_b"] == pytest.approx(content["metrics"]["mse"])
    few = ("trainer.limit_test_batches=0.01", f"hydra.run.dir={tmp_path / 'few'}")
    too_few = train("scenario=collision", "model=copy_b", *few, data=tiny_data, code=1)
    assert "trainer: You requested to check" in too_few
    assert "Traceback" not in too_few


@pytest.mark.slow
def test_a_limited_test_of_a_derenderer_counts_what_it_tested(tiny_data: Path, tmp_path: Path) -> None:
    short = ("num_images=40", "trainer.max_epochs=1", "trainer.limit_train_batches=1", "model.width=1")
    limited = ("training.batch_size=2", "trainer.limit_test_batches=1", f"hydra.run.dir={tmp_path}")
    printed = train("scenario=collision", "model=derenderer", *short, *limited, data=tiny_data)
    assert "twins" not in printed
    assert json.loads((tmp_path / "metrics.json").read_text())["num_test"] == 2


@pytest.mark.slow
def test_the_share_is_printed_if_both_oracles_have_runs(tiny_data: Path, tmp_path: Path) -> None:
    arguments = (*ROW, f"source.outputs={tmp_path}")
    for oracle in ("oracle_feedforward", "oracle_counterfactual"):
        train(*arguments, f"model={oracle}", data=tiny_data)
    printed = train(*arguments, "model=copy_b", data=tiny_data)
    ours, without, with_ab = (
        metrics_of(tmp_path, model)["metrics"]["mse"]
        for model in ("copy_b", "oracle_feedforward", "oracle_counterfactual")
    )
    # tiny data have one cluster of test experiments, so no interval
    assert line(printed, "Share of the possible gain") == f"{(without - ours) / (without - with_ab):.0%}"
    (strange,) = tmp_path.glob("collision/all/oracle_feedforward/full/ground_truth/*/metrics.json")
    strange.write_text("[]")
    assert "Share" not in train(*arguments, "model=copy_b", "reuse=false", data=tiny_data)


@pytest.mark.parametrize(
    ("split", "model", "ablation", "number", "derendered"),
    [
        ("3to4", "cophynet", "full", 0.482, 0.504),  # the second in Table 7
        ("3to3", "in", "gt_confounders", 0.296, None),
        ("3to3_seen", "npe", "full", None, None),
    ],
)
def test_the_papers_number_is_that_of_the_row(
    split: str, model: str, ablation: str, number: float | None, derendered: float | None
) -> None:
    names = {"scenario": "blocktower", "split": split, "model": model, "ablation": ablation, "size": "small"}
    assert published_mse({**names, "positions": "ground_truth"}) == number
    assert published_mse({**names, "positions": "derendered"}) == derendered
