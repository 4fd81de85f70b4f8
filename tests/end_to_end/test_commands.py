"""Trainings, sweeps and reports on tiny data, by the commands of the README."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

import cophy
from tests.commands import run, train
from tests.conftest import SCENARIOS

FIELDS = {
    "scenario", "split", "model", "ablation", "positions", "seed", "size", "variant", "validation",
    "dataset_ids", "derenderer", "predictor", "max_epochs", "num_train", "num_test", "training_seconds", "resumed", "wall_seconds", "metrics", "intervals",
    "copies",
}  # fmt: skip


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_row_runs_from_data_to_metrics(name: str, tiny_data: Path, tmp_path: Path) -> None:
    train(f"scenario={name}", "logger=tensorboard", f"hydra.run.dir={tmp_path}", data=tiny_data)
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert set(content) == FIELDS
    assert content["scenario"] == name
    assert content["num_train"] == 34
    assert content["num_test"] == 4
    assert set(content["metrics"]) >= {"mse", "final_position_error", "stability_accuracy", "stability_base_rate"}
    assert set(content["intervals"]) == set(content["metrics"])
    assert {path.name for path in (tmp_path / "checkpoints").iterdir()} == {"best.ckpt", "last.ckpt", "finished.json"}
    with np.load(tmp_path / "predictions.npz") as predictions:
        steps = 14 if name == "collision" else 29
        shape = (4, steps, *predictions["initial"].shape[1:])
        assert predictions["position"].shape == predictions["target"].shape == shape
        predictor = cophy.load_predictor(tmp_path / "checkpoints" / "best.ckpt")
        data = cophy.load(name, size="tiny", split="test", data_dir=str(tiny_data))
        (batch,) = DataLoader(data, batch_size=4)
        batch["states"][:, 1, 1:] = 0  # D, which is to be predicted
        present = batch["presence"][:, 1, None, :, None]
        torch.testing.assert_close(predictor(batch), torch.from_numpy(predictions["position"]) * present)
    assert (tmp_path / ".hydra" / "config.yaml").exists()
    curves = EventAccumulator(str(tmp_path / "tensorboard"))
    curves.Reload()
    scalars = set(curves.Tags()["scalars"])
    assert {
        "mse/val",
        "mse/test",
        "train/mse",
        "val/stability_accuracy",
        "train/lr-Adam",
        "train/gradient_norm",
    } <= scalars
    assert "epoch" not in scalars
    assert any(name.startswith("per_cell/") for name in scalars) == (name != "balls")
    assert {"val/trajectories", "val/error_over_time", "val/clip"} <= set(curves.Tags()["images"])


def test_a_fast_dev_run_takes_a_step_and_leaves_no_results(tiny_data: Path, tmp_path: Path) -> None:
    train("trainer.fast_dev_run=true", f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert not (tmp_path / "metrics.json").exists()
    assert not (tmp_path / "checkpoints").exists()


def test_the_same_seed_gives_the_same_numbers_and_another_does_not(tiny_data: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(f"seed={seed}", f"hydra.run.dir={tmp_path / name}", data=tiny_data)
    metrics = {name: json.loads((tmp_path / name / "metrics.json").read_text())["metrics"] for name in "abc"}
    assert metrics["a"] == metrics["b"]
    assert metrics["a"] != metrics["c"]


def test_resuming_goes_on_where_training_stopped(tiny_data: Path, tmp_path: Path) -> None:
    def state(name: str) -> tuple[int, int, float]:
        checkpoint = torch.load(tmp_path / name / "checkpoints" / "last.ckpt", weights_only=True)
        return (
            checkpoint["epoch"],
            checkpoint["global_step"],
            checkpoint["optimizer_states"][0]["param_groups"][0]["lr"],
        )

    train("trainer.max_epochs=4", f"hydra.run.dir={tmp_path / 'whole'}", data=tiny_data)
    train("trainer.max_epochs=2", f"hydra.run.dir={tmp_path / 'part'}", data=tiny_data)
    assert state("part") != state("whole")
    last = tmp_path / "part" / "checkpoints" / "last.ckpt"
    splits = "scenario.task.splits=[3to3,mine]"  # names of splits are no setting of a training
    train("trainer.max_epochs=4", f"ckpt={last}", splits, f"hydra.run.dir={tmp_path / 'rest'}", data=tiny_data)
    assert state("rest") == state("whole")


def test_a_checkpoint_of_another_training_and_weights_alone_are_refused(tiny_data: Path, tmp_path: Path) -> None:
    train("model.hidden_dim=8", f"hydra.run.dir={tmp_path}", data=tiny_data)
    last = tmp_path / "checkpoints" / "last.ckpt"
    printed = train(f"ckpt={last}", f"hydra.run.dir={tmp_path / 'other'}", data=tiny_data, code=1)
    assert "belongs to another training (model.hidden_dim=8)" in printed
    other = ("model.hidden_dim=8", f"ckpt={last}", "seed=1", "trainer.precision=64-true", "trainer.max_epochs=2")
    printed = train(*other, f"hydra.run.dir={tmp_path / 'other'}", data=tiny_data, code=1)
    assert "belongs to another training (seed=0, trainer.precision=32-true): use the same settings" in printed
    best = last.with_name("best.ckpt")
    assert best.stat().st_size < last.stat().st_size / 2
    printed = train("model.hidden_dim=8", f"ckpt={best}", f"hydra.run.dir={tmp_path / 'other'}", data=tiny_data, code=1)
    assert "holds only weights, for tests and predictions: use the run's last.ckpt" in printed


def test_generate_refuses_the_split_of_another_scenario(tmp_path: Path) -> None:
    printed = run("generate", "scenario=balls", "split=3to4", f"data_dir={tmp_path}", code=1)
    assert "split=3to4 does not go with balls: use 4to4, 4to2, 4to3, 4to5, 4to6" in printed


def test_every_ablation_runs_as_one_multirun_and_fills_the_report(tiny_data: Path, tmp_path: Path) -> None:
    sweep = ("-m", f"hydra.sweep.dir={tmp_path}", "scenario=blocktower")
    train(*sweep, "ablation=glob(*)", data=tiny_data)
    train(*sweep, "model=copy_c,copy_b", data=tiny_data)
    train(*sweep, "model.hidden_dim=8", "seed=7", data=tiny_data)
    printed = run("report", f"outputs={tmp_path}", f"data_dir={tiny_data}")
    assert "hidden_dim-8" in printed  # a run of its own fills no table
    assert "cophynet static_gating" in (tmp_path / "report" / "difficulty.md").read_text()
    markdown = (tmp_path / "report" / "tables.md").read_text()
    assert "— / 0.318" in markdown  # IN was not run
    assert markdown.index("# Table 2") < markdown.index("# Table 3")  # tables without any run come last
    assert markdown.index("# Table 6") < markdown.index("# Table 4")
    names = {path.name for path in (tmp_path / "report" / "figures").iterdir()}
    drawn = {"table-blocktower", "error_over_time-blocktower-3to3", "trajectories-blocktower-3to3-cophynet"}
    drawn |= {"difficulty-blocktower-3to3-tiny", "stability_distribution-tiny"}
    assert {f"{name}.{kind}" for name in drawn for kind in ("png", "pdf")} <= names
    (tmp_path / "empty").mkdir()
    assert "there are no runs; train.py writes them" in run("report", f"outputs={tmp_path / 'empty'}", code=1)
    assert not list((tmp_path / "empty").iterdir())
    printed = run("report", f"outputs={tmp_path}", f"directory={tmp_path}/elsewhere", "data_dir=nowhere")
    assert "nowhere/blocktower/3-tiny-" in printed
    assert not (tmp_path / "elsewhere" / "difficulty.md").exists()
    row = next(line for line in markdown.splitlines() if line.startswith("| 3→3 "))
    assert row.count("—") == 3 + 6 * 2  # IN, NPE, IN sup.; both alongside and oracles: no numbers in the paper either
    assert "Size tiny: 34 training and 4 test experiments; 1 epochs; seeds 0." in markdown
    assert (
        (tmp_path / "report" / "blocktower.csv")
        .read_text()
        .startswith("row,column,metric,ours,sd,low,high,seeds,failed,paper,best")
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "split"),
    [
        ("blocktower", "3to4"),
        ("blocktower", "3to3_seen"),
        ("balls", "4to2"),
        ("balls", "4to6"),
        ("collision", "sphere_to_cylinder"),
    ],
)
def test_transfers_run(name: str, split: str, tiny_data: Path, tmp_path: Path) -> None:
    train(f"scenario={name}", f"split={split}", f"hydra.run.dir={tmp_path}", data=tiny_data)
    assert json.loads((tmp_path / "metrics.json").read_text())["split"] == split
