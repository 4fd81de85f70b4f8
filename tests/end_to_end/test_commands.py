"""Trainings, sweeps and reports on tiny data, by the commands of the README."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

import cophy
from cophy.report.paper_tables import paper_tables
from tests.commands import run, train

FIELDS = {
    "scenario", "split", "model", "ablation", "positions", "seed", "size", "variant", "validation",
    "dataset_ids", "derenderer", "predictor", "max_epochs", "num_train", "num_test", "metric_dims", "training_seconds", "training_cpu_seconds", "resumed", "wall_seconds", "metrics", "intervals",
    "copies", "changes", "inputs", "parameters", "optimizer", "learning_rate",
}  # fmt: skip


def test_a_run_leaves_metrics_predictions_curves_and_checkpoints(trained_run: Path, tiny_data: Path) -> None:
    check_results(trained_run, "collision", tiny_data)
    curves = EventAccumulator(str(next(trained_run.parents[5].rglob("events.out.tfevents.*")).parent))
    curves.Reload()
    scalars = set(curves.Tags()["scalars"])
    assert {"mse/val", "mse/test", "train/mse", "val/stability_accuracy", "train/lr-SOAP"} <= scalars
    assert "train/gradient_norm" in scalars
    assert "epoch" not in scalars
    assert any(name.startswith("per_cell/") for name in scalars)
    assert {"val/trajectories", "val/error_over_time", "val/clip"} <= set(curves.Tags()["images"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["blocktower", "balls"])
def test_runs_of_the_other_scenarios_leave_the_same_files(name: str, tiny_data: Path, tmp_path: Path) -> None:
    train(f"scenario={name}", f"hydra.run.dir={tmp_path}", data=tiny_data)
    check_results(tmp_path, name, tiny_data)


def check_results(run: Path, name: str, data_dir: Path) -> None:
    """Check the files of a run, and that its checkpoint predicts what it stored."""
    content = json.loads((run / "metrics.json").read_text())
    assert set(content) == FIELDS
    assert content["scenario"] == name
    assert content["num_train"] == 34
    assert content["num_test"] == 4
    assert set(content["metrics"]) >= {"mse", "final_position_error", "stability_accuracy", "stability_base_rate"}
    assert set(content["intervals"]) == set(content["metrics"])
    assert {path.name for path in (run / "checkpoints").iterdir()} == {"best.ckpt", "last.ckpt", "finished.json"}
    assert (run / ".hydra" / "config.yaml").exists()
    with np.load(run / "predictions.npz") as predictions:
        steps = 14 if name == "collision" else 29
        shape = (4, steps, *predictions["initial"].shape[1:])
        assert predictions["position"].shape == predictions["target"].shape == shape
        predictor = cophy.load_predictor(run / "checkpoints" / "best.ckpt")
        data = cophy.load(name, size="tiny", split="test", data_dir=str(data_dir))
        (batch,) = DataLoader(data, batch_size=4)
        batch["states"][:, 1, 1:] = 0  # D, which is to be predicted
        rows = np.searchsorted(data.rows, predictions["experiment"])  # twins are next to each other in predictions.npz
        present = batch["presence"][rows, 1, None, :, None]
        torch.testing.assert_close(predictor(batch)[rows], torch.from_numpy(predictions["position"]) * present)


def test_a_fast_dev_run_takes_a_step_and_leaves_no_results(tiny_data: Path, tmp_path: Path) -> None:
    train("scenario=collision", "trainer.fast_dev_run=true", f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert not (tmp_path / "metrics.json").exists()
    assert not (tmp_path / "checkpoints").exists()
    assert logging.raiseExceptions  # errors in log calls are shown during and after a run


def test_the_same_seed_gives_the_same_numbers_and_another_does_not(
    trained_run: Path, tiny_data: Path, tmp_path: Path
) -> None:
    metrics = [json.loads((trained_run / "metrics.json").read_text())["metrics"]]
    for seed in (0, 1):
        train("scenario=collision", f"seed={seed}", f"hydra.run.dir={tmp_path / str(seed)}", data=tiny_data)
        metrics.append(json.loads((tmp_path / str(seed) / "metrics.json").read_text())["metrics"])
    assert metrics[0] == metrics[1]
    assert metrics[0] != metrics[2]


def test_a_checkpoint_of_another_training_and_weights_alone_are_refused(
    trained_run: Path, tiny_data: Path, tmp_path: Path
) -> None:
    keys = ("scenario=collision", f"hydra.run.dir={tmp_path}")
    last, best = (trained_run / "checkpoints" / name for name in ("last.ckpt", "best.ckpt"))
    others = ("model.hidden_dim=8", "seed=1", "trainer.precision=64-true", "trainer.max_epochs=2")
    printed = train(*keys, f"ckpt={last}", *others, data=tiny_data, code=1)
    assert "belongs to another training (" in printed
    assert "model.hidden_dim=32" in printed
    assert "seed=0" in printed
    assert "trainer.precision=32-true" in printed
    assert "max_epochs" not in printed.partition("belongs to another training")[2].partition(":")[0]
    assert best.stat().st_size < last.stat().st_size / 2
    printed = train(*keys, f"ckpt={best}", data=tiny_data, code=1)
    assert "holds only weights, for tests and predictions: use the run's last.ckpt" in printed


def test_a_report_has_the_numbers_of_the_run(outputs: Path, tiny_data: Path, tmp_path: Path) -> None:
    printed = run("report", f"outputs={outputs}", f"directory={tmp_path}", f"data_dir={tiny_data}")
    content = json.loads(next(outputs.rglob("metrics.json")).read_text())
    assert f"{content['metrics']['mse']:.3f}" in (tmp_path / "tables.md").read_text()
    assert (tmp_path / "collision.csv").exists()
    assert "Traceback" not in printed


def test_a_report_without_runs_is_refused(tmp_path: Path) -> None:
    assert "there are no runs; train.py writes them" in run("report", f"outputs={tmp_path}", code=1)
    assert not list(tmp_path.iterdir())


def test_trees_are_fitted_and_validated(tiny_data: Path, tmp_path: Path) -> None:
    arguments = ("scenario=collision", "model=trees_confounders", "model.num_trees=2", f"hydra.run.dir={tmp_path}")
    train(*arguments, data=tiny_data)
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert 0 < content["validation"]["val/mse"] < content["copies"]["copy_c"]
    assert not list(tmp_path.rglob("*.ckpt"))


@pytest.mark.slow
def test_every_ablation_runs_as_one_multirun_and_fills_the_report(tiny_data: Path, tmp_path: Path) -> None:
    sweep = ("-m", f"hydra.sweep.dir={tmp_path}", "scenario=blocktower")
    train(*sweep, "ablation=glob(*)", data=tiny_data)
    train(*sweep, "model=copy_c,copy_b", data=tiny_data)
    train(*sweep, "model.hidden_dim=8", "seed=7", data=tiny_data)
    printed = run("report", f"outputs={tmp_path}", f"data_dir={tiny_data}")
    assert "CoPhyNet (hidden_dim=8)" in " ".join(printed.split())
    assert "Static gating" in (tmp_path / "report" / "difficulty.md").read_text()
    markdown = (tmp_path / "report" / "tables.md").read_text()
    assert "0.318" not in markdown  # IN was not run
    assert "Table 2" in markdown
    assert "Table 3" not in markdown
    names = {path.name for path in (tmp_path / "report" / "figures").iterdir()}
    drawn = {"table-blocktower", "error_over_time-blocktower-3to3", "trajectories-blocktower-3to3-cophynet"}
    drawn |= {"difficulty-blocktower-3to3-tiny", "stability_distribution-tiny"}
    assert {f"{name}.{kind}" for name in drawn for kind in ("png", "pdf")} <= names
    printed = run("report", f"outputs={tmp_path}", f"directory={tmp_path}/elsewhere", "data_dir=nowhere", "paper=true")
    assert "nowhere/blocktower/3-tiny-" in printed
    assert not (tmp_path / "elsewhere" / "difficulty.md").exists()
    markdown = (tmp_path / "elsewhere" / "tables.md").read_text()
    assert "Table 3" in markdown
    row = next(line for line in markdown.splitlines() if line.startswith("| 3→3 "))
    beyond = len(next(table for table in paper_tables() if table.id == "blocktower").columns) - 6  # six are the paper's
    assert row.count("—") == 3 + 2 * beyond  # IN, NPE, IN sup.; those beyond the paper have no number there either
    assert "Size tiny: 34 training and 4 test experiments; 1 epochs; seeds 0." in markdown
    assert (
        (tmp_path / "report" / "blocktower.csv")
        .read_text()
        .startswith("row,column,metric,ours,sd,low,high,seeds,failed,paper,best")
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "split"), [("blocktower", "3to4"), ("collision", "sphere_to_cylinder")])
def test_transfers_run(name: str, split: str, tiny_data: Path, tmp_path: Path) -> None:
    train(f"scenario={name}", f"split={split}", f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert json.loads((tmp_path / "metrics.json").read_text())["split"] == split
