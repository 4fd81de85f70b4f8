"""The commands of the README on tiny data."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

import cophy
from cophy.training.trained.trained_derenderer import TrainedDerenderer
from tests.commands import run, train
from tests.conftest import SCENARIOS

FIELDS = {
    "scenario", "split", "model", "ablation", "positions", "seed", "size", "variant", "validation",
    "dataset_ids", "derenderer", "predictor", "max_epochs", "num_train", "num_test", "training_seconds", "resumed", "wall_seconds", "metrics", "intervals",
    "copies",
}  # fmt: skip


def audit(data: Path, **kwargs: int) -> str:
    where = (f"data_dir={data}", f"directory={data}/audit")
    return run("audit", "scenario=collision", "size=tiny", "replayed_pairs=2", *where, **kwargs)


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
    assert "is of another training (model.hidden_dim=8)" in printed
    best = last.with_name("best.ckpt")
    assert best.stat().st_size < last.stat().st_size / 2
    printed = train("model.hidden_dim=8", f"ckpt={best}", f"hydra.run.dir={tmp_path / 'other'}", data=tiny_data, code=1)
    assert "holds weights alone, for tests and predictions: go on from the run's last.ckpt" in printed


def test_generate_refuses_the_split_of_another_scenario(tmp_path: Path) -> None:
    printed = run("generate", "scenario=balls", "split=3to4", f"data_dir={tmp_path}", code=1)
    assert "split=3to4 does not go with balls: use 4to4, 4to2, 4to3, 4to5, 4to6" in printed


def test_every_ablation_runs_as_one_multirun_and_fills_the_report(tiny_data: Path, tmp_path: Path) -> None:
    sweep = ("-m", f"hydra.sweep.dir={tmp_path}", "scenario=blocktower")
    train(*sweep, "ablation=glob(*)", data=tiny_data)
    train(*sweep, "model=copy_c,copy_b", data=tiny_data)
    train(*sweep, "model.hidden_dim=8", "seed=7", data=tiny_data)
    printed = run("report", f"outputs={tmp_path}", f"data_dir={tiny_data}")
    assert "model.hidden_dim=8" in printed  # a run of its own fills no table
    assert "cophynet static_gating" in (tmp_path / "report" / "difficulty.md").read_text()
    markdown = (tmp_path / "report" / "tables.md").read_text()
    assert "— / 0.318" in markdown  # IN was not run
    assert markdown.index("# Table 2") < markdown.index("# Table 3")  # tables without any run come last
    assert markdown.index("# Table 6") < markdown.index("# Table 4")
    names = {path.name for path in (tmp_path / "report" / "figures").iterdir()}
    of_models = {f"trajectories-blocktower-3to3-{model}" for model in ("cophynet", "cophynet-mlp", "copy_c", "copy_b")}
    drawn = {"table-blocktower", "error_over_time-blocktower-3to3", *of_models}
    drawn |= {"difficulty-blocktower-3to3-tiny", "stability_distribution-tiny"}
    assert {f"{name}.{kind}" for name in drawn for kind in ("png", "pdf")} <= names
    (tmp_path / "empty").mkdir()
    assert "there are no runs to report" in run("report", f"outputs={tmp_path / 'empty'}", code=1)
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


def test_a_damaged_shard_stops_training_with_its_remedy(tiny_data: Path, tmp_path: Path) -> None:
    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")
    shard = next(tmp_path.rglob("shard-00001.h5"))
    shard.write_bytes(shard.read_bytes()[:1000])
    printed = train("scenario=collision", f"hydra.run.dir={tmp_path / 'run'}", data=tmp_path, code=1)
    assert "shard-00001.h5 is damaged" in printed
    assert "run `python src/generate.py scenario=collision" in printed
    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")
    audit(tmp_path)
    (page,) = tmp_path.glob("audit/*/audit.md")
    assert "FAILS" not in page.read_text()
    assert all(page.with_name(f"{name}.png").stat().st_size > 10_000 for name in ("outcomes", "bias"))
    assert "lines hold (2 twin pairs" in shard.with_name("README.md").read_text()


def test_audit_names_what_is_wrong(tmp_path: Path) -> None:
    """Consistent checksums do not save a dataset whose twins do not belong together, or whose states are no numbers."""
    import h5py

    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")
    shard = next(tmp_path.rglob("shard-00000.h5"))
    with h5py.File(shard, "r+") as file:
        file["split"][0] = 2 - file["split"][0]
        file["states"][5, 1, 7] = np.nan
    manifest = shard.with_name("manifest.json")
    manifest.unlink()
    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")  # vouches for what it finds
    printed = audit(tmp_path, code=1)
    assert "audit: 2-tiny" in printed
    assert "twins share all but confounders: split" in printed
    assert "states are finite, empty slots zero: no" in printed
    assert "Traceback" not in printed
    (page,) = tmp_path.glob("audit/*/audit.md")
    assert page.read_text().count("FAILS") == printed.count("audit: ")
    assert "lines fail: " in shard.with_name("README.md").read_text()
    shard.write_bytes(shard.read_bytes()[:-100])
    printed = audit(tmp_path, code=1)
    assert "shard-00000.h5 is damaged (its checksum is not the one in manifest.json): run `python src/gen" in printed
    assert "Traceback" not in printed


def test_from_pictures_to_a_counterfactual(tiny_data: Path, tmp_path: Path) -> None:
    """De-renderer, estimates, a predictor that sees them, and a prediction from files."""
    small = ("scenario=collision", f"source.outputs={tmp_path}")

    def directory(model: str, positions: str) -> Path:
        (found,) = tmp_path.glob(f"collision/all/{model}/full/{positions}/seed0+size-tiny*")
        return found

    sizes = ("model.resolution=16", "model.width=2", "model.readout=linear", "num_images=200", "trainer.max_epochs=2")
    train("model=derenderer", *small, "render.resolution=16", "logger=tensorboard", *sizes, data=tiny_data)
    row = directory("derenderer", "ground_truth")
    measured = json.loads((row / "metrics.json").read_text())["metrics"]
    assert {"mse", "euclidean_error", "x_error", "presence_accuracy", "mean_position_error"} <= set(measured)
    curves = EventAccumulator(str(tmp_path / "tensorboard" / f"collision_all_derenderer_{row.name}"))
    curves.Reload()
    assert {"val/centres", "val/clip"} <= set(curves.Tags()["images"])

    derender = ("derender", "scenario=collision", "size=tiny", f"data_dir={tiny_data}", f"outputs={tmp_path}")
    said = run(*derender)
    assert "48 experiments, 2 shards, all whole" in said
    (estimates,) = tiny_data.rglob(f"derendered-{TrainedDerenderer(row / 'checkpoints' / 'best.ckpt').name}")
    whole = {path.name: path.read_bytes() for path in estimates.iterdir() if path.suffix in (".h5", ".json")}
    shutil.rmtree(estimates)
    assert "part 1 of 2 is whole, others are not yet" in run(*derender, "part=1", "parts=2")
    run(*derender, "part=0", "parts=2")
    assert len(whole) == 3
    assert {name: (estimates / name).read_bytes() for name in whole} == whole

    for positions in ("derendered", "train_ground_truth_test_derendered"):
        train(*small, f"positions={positions}", data=tiny_data)
        seen = directory("cophynet", positions)
        assert json.loads((seen / "metrics.json").read_text())["positions"] == positions

    look = tmp_path / "look"
    run(
        "look",
        "scenario=collision",
        "size=tiny",
        f"data_dir={tiny_data}",
        "num_shown=1",
        "render.resolution=32",
        f"directory={look}",
    )
    assert {path.name for path in look.iterdir()} == {
        "sheet.png",
        "twins.png",
        "strip.png",
        "modalities.png",
        "clip.gif",
        "AB",
        "CD",
        "background.png",
    }
    checkpoints = {
        "derenderer": row / "checkpoints" / "best.ckpt",
        "predictor": directory("cophynet", "derendered") / "checkpoints" / "best.ckpt",
    }
    given = [f"{key}={path}" for key, path in checkpoints.items()]
    files = [f"observed={look / 'AB'}", f"initial={look / 'CD' / '00.png'}", f"truth={look / 'CD'}"]
    run("predict", *files, *given, f"background={look / 'background.png'}", f"directory={tmp_path / 'predicted'}")
    assert (tmp_path / "predicted" / "prediction.gif").read_bytes()[:4] == b"GIF8"
    assert (tmp_path / "predicted" / "positions.csv").read_text().startswith("frame,object,x_m,y_m,z_m\n0,")
    swapped = run("predict", *files, f"derenderer={checkpoints['predictor']}", given[1], code=1)
    assert "not of a de-renderer" in swapped
    short = run("predict", files[1], f"observed={look / 'CD' / '00.png'}", *given, code=1)
    assert "AB has 1 frames; the predictor knows 15" in short
