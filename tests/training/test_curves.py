"""What TensorBoard is given: results first, nothing constant, short names of runs."""

from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cophy.training.figures import Curves
from cophy.training.run import Run


def kept(directory: Path) -> EventAccumulator:
    curves = EventAccumulator(str(directory))
    curves.Reload()
    return curves


def run_of(root: Path, **changes: object) -> Run:
    names = {"scenario": "balls", "split": "3to3", "model": "in", "ablation": "full", "positions": "ground_truth"}
    run = Run(**{**names, "seed": 0, "size": "small", "variant": "", **changes}, directory=root)
    return Run(**run.names(), directory=root / run.place)


def test_the_first_card_is_a_result(tmp_path: Path) -> None:
    curves = Curves(str(tmp_path), name="", version="", default_hp_metric=False)
    curves.log_metrics({"epoch": 0, "train/loss": 1.0, "lr-Adam": 0.1, "val/mse": 2.0, "val/mse_both_stand": 3.0}, 5)
    curves.log_hyperparams({"model": "in", "nothing": None})
    curves.save()
    curves.log_results({"mse": 4.0, "pixel_error": 7.0}, 9)
    curves.save()
    found = kept(tmp_path)
    tags = sorted(found.Tags()["scalars"])
    assert tags == ["mse/test", "mse/val", "per_cell/mse_both_stand", "test/pixel_error", "train/loss", "train/lr-Adam"]
    assert [(event.step, event.value) for event in found.Scalars("mse/test")] == [(9, 4.0)]


def test_a_training_anew_forgets_the_curves_of_an_earlier_one(tmp_path: Path) -> None:
    for value in (1.0, 2.0):
        curves = Curves(str(tmp_path), name="", version="", default_hp_metric=False)
        curves.log_metrics({"val/mse": value}, 0)
        curves.forget_earlier()
        curves.save()
        curves.experiment.close()
    assert [event.value for event in kept(tmp_path).Scalars("mse/val")] == [2.0]


def test_short_names_tell_runs_apart(tmp_path: Path) -> None:
    runs = [
        run_of(tmp_path),
        run_of(tmp_path, ablation="feedforward"),
        run_of(tmp_path, positions="derendered"),
        run_of(tmp_path, seed=1),
        run_of(tmp_path, variant="+size-tiny"),
    ]
    assert [run.short_name for run in runs] == [
        "balls_3to3_in_seed0",
        "balls_3to3_in_feedforward_seed0",
        "balls_3to3_in_derendered_seed0",
        "balls_3to3_in_seed1",
        "balls_3to3_in_seed0+size-tiny",
    ]
