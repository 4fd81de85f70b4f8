"""Runs as a table."""

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from cophy.commands.report import ComposedData
from cophy.errors import CophyError
from cophy.report import pipeline
from cophy.report.methods import method_cells
from cophy.report.predictions import read_stored_predictions
from cophy.report.runs import comparable_seeds, filter_runs, largest_size, read_runs, standard_runs
from tests.report.lines import measured, run
from tests.report.stored_runs import PLACE, content, leave


def leave_failure(directory: Path, error: object) -> None:
    directory.mkdir(parents=True)
    names = {key: value for key, value in content().items() if isinstance(value, str)} | {"seed": 0}
    (directory / "failure.json").write_text(json.dumps(names | {"error": error}))


def no_dataset(scenario: str, size: str) -> None:
    """Datasets are not checked."""


def test_runs_that_differ_in_their_seed_alone_may_be_averaged() -> None:
    seen = [
        measured("mse", 0.2, "cophynet", seed=seed, derenderer=name) for seed, name in ((0, "b"), (1, "a"), (2, "a"))
    ]
    assert comparable_seeds(pd.DataFrame(seen))["seed"].tolist() == [1, 2]
    both = pd.DataFrame([*seen, measured("mse", 0.1, "cophynet", seed=5, epochs=120, derenderer="b")])
    assert comparable_seeds(both)["seed"].tolist() == [5]
    named = [measured("mse", 0.2, "cophynet", seed=0, derenderer="a", variant=name) for name in ("+derenderer-x", "")]
    assert comparable_seeds(pd.DataFrame(named))["variant"].tolist() == [""]  # a seed counts once
    copies = [measured("mse", 0.2, "copy_b", seed=seed, epochs=8 + seed, is_trained=False) for seed in (0, 1)]
    assert comparable_seeds(pd.DataFrame(copies))["seed"].tolist() == [0, 1]
    sizes = pd.DataFrame(
        [measured("mse", 0.2, "in", size=name, num_train=n) for name, n in (("paper", 900), ("12k", 400))]
    )
    assert largest_size(sizes)["size"].tolist() == ["paper"]


def test_what_was_refused_before_it_began_is_no_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    for seed, begun in enumerate((True, False)):
        directory = tmp_path / PLACE.with_name(f"seed{seed}")
        directory.mkdir(parents=True)
        names = content(seed=seed, error="ValueError: boom", has_begun=begun)
        (directory / "failure.json").write_text(json.dumps(names))
    runs = read_runs(tmp_path)
    assert (runs["seed"].tolist(), runs.attrs["unused"], caplog.text) == ([0], 0, "")


def test_only_runs_in_their_own_place_are_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    for directory in (PLACE, Path("demo") / PLACE, Path("blocktower/3to3/in/full/ground_truth/seed0")):
        leave(tmp_path / directory, json.dumps(content()))
    runs = read_runs(tmp_path)
    assert list(runs["directory"]) == [tmp_path / PLACE]
    assert "are not where train.py puts them and are not read" in " ".join(caplog.text.split())
    assert runs.iloc[0][["metrics.mse", "low.mse", "high.mse", "epochs", "metric_dims"]].tolist() == [
        0.2,
        0.1,
        0.3,
        80,
        3,
    ]


def test_runs_with_other_settings_are_read_and_fill_no_table_of_the_paper(tmp_path: Path) -> None:
    for variant in ("", "+size-tiny+max_epochs-1", "+size-tiny+hidden_dim-8"):
        leave(tmp_path / PLACE.with_name(f"seed0{variant}"), json.dumps(content(variant=variant)))
    runs = read_runs(tmp_path)
    assert len(runs) == 3
    assert sorted(standard_runs(runs, no_dataset)["variant"]) == ["", "+size-tiny+max_epochs-1"]


def test_changes_have_whole_keys_and_are_of_the_data_or_the_method(tmp_path: Path) -> None:
    new = {
        "variant": "+data_seed-1+hidden_dim-8",
        "changes": {"size": "tiny", "data_seed": "1", "model.hidden_dim": "8"},
    }
    for seed, changes in enumerate((new, {"variant": "+hidden_dim-16"}, {})):
        named = content(seed=seed, validation={"val/mse": 0.5}, **changes)
        leave(tmp_path / PLACE.with_name(f"seed{seed}{named.get('variant', '')}"), json.dumps(named))
    runs = read_runs(tmp_path)
    assert runs["data"].tolist() == ["data_seed=1", "", ""]
    assert runs["changes"].tolist() == [(("model.hidden_dim", "8"),), (("model.hidden_dim", "16"),), ()]
    assert runs["validation_mse"].tolist() == [0.5] * 3


def test_keys_of_training_change_no_run_that_trained_nothing(tmp_path: Path) -> None:
    epochs, jitter = {"trainer.max_epochs": "8"}, {"model.jitter": "2", "training.learning_rate": "0.1"}
    places = {
        "copy_b": ({"size": "tiny", **epochs}, {"size": "tiny"}, {"size": "tiny", "optimizer": "adam"}),
        "noise": (epochs, jitter),
        "trees": ({"training.num_experiments": "8"}, epochs),
        "tested": (epochs, {}),
        "in": (epochs, {}),
    }
    for model, runs_of_model in places.items():
        for changes in runs_of_model:
            variant = "".join(f"+{key.rpartition('.')[2]}-{value}" for key, value in changes.items())
            facts = {
                "training_seconds": 100.0 if model == "in" else 0.0,
                "predictor": "x" if model == "tested" else None,
            }
            directory = tmp_path / "blocktower" / "3to3" / model / "full" / "ground_truth" / f"seed0{variant}"
            leave(directory, json.dumps(content(model=model, variant=variant, changes=changes, **facts)))
    runs = read_runs(tmp_path)
    of = {model: sorted(zip(part["variant"], part["changes"], strict=True)) for model, part in runs.groupby("model")}
    assert of["copy_b"] == [("+size-tiny", ())]
    assert runs[runs["model"] == "copy_b"]["directory"].iloc[0].name == "seed0+size-tiny"
    assert of["noise"] == [("", ()), ("+jitter-2", (("model.jitter", "2"),))]
    assert of["trees"] == [("", ()), ("+num_experiments-8", (("training.num_experiments", "8"),))]
    assert of["tested"] == of["in"] == [("", ()), ("+max_epochs-8", (("trainer.max_epochs", "8"),))]


def test_filters_take_models_rows_and_splits_and_name_those_that_exist() -> None:
    runs = pd.DataFrame([run("in"), run("in", "gt_confounders", split="3to4"), run("drift")])

    def chosen(models: list[str], splits: list[str]) -> list[int]:
        return filter_runs(runs, models, splits).index.tolist()

    assert chosen([], []) == [0, 1, 2]
    assert chosen(["in"], []) == [0, 1]
    assert chosen(["in_sup", "drift"], []) == chosen(["in_gt_confounders", "drift"], []) == [1, 2]
    assert chosen(["in"], ["3to4"]) == [1]
    with pytest.raises(
        CophyError, match=r"models=: there is no run of drft; there are drift, in, in_gt_confounders, in_sup"
    ):
        chosen(["drft"], [])
    with pytest.raises(CophyError, match=r"splits=: there is no run of 4to4; there are 3to3, 3to4"):
        chosen([], ["4to4"])
    with pytest.raises(CophyError, match=r"models=\['drift'\] and splits=\['3to4'\]"):
        chosen(["drift"], ["3to4"])


@pytest.mark.parametrize("fault", [AttributeError, KeyError, TypeError, ValueError])
def test_faults_of_the_code_keep_their_traceback(tmp_path: Path, fault: type[Exception]) -> None:
    leave(tmp_path / PLACE, json.dumps(content()))

    def faulty(scenario: str, size: str) -> None:
        raise fault("a fault")

    with pytest.raises(fault, match="a fault"):
        standard_runs(read_runs(tmp_path), faulty)


def test_a_run_on_other_data_than_its_names_stand_for_fills_no_table_of_the_paper(tmp_path: Path) -> None:
    for seed, dataset in enumerate(("3-x", "3-old")):
        leave(tmp_path / PLACE.with_name(f"seed{seed}"), json.dumps(content(seed=seed, dataset_ids=[dataset])))
    assert standard_runs(read_runs(tmp_path), lambda scenario, size: {"3-x"})["seed"].tolist() == [0]


def test_names_stand_for_the_data_that_are_generated_today() -> None:
    data = ComposedData("generated", Path("data"))
    ids = {data.dataset("blocktower", count, "tiny").id for count in (4, 3)}
    assert ids <= set(data.dataset_ids("blocktower", "tiny") or ())
    assert ComposedData("cophy", Path("data")).dataset_ids("blocktower", "cophy") is None
    with pytest.raises(CophyError, match="nowhere"):
        data.dataset_ids("blocktower", "nowhere")
    with pytest.raises(CophyError, match="source=cophy"):
        data.dataset_ids("blocktower", "cophy")


INVALID = {
    "no JSON": "{",
    "a list": "[]",
    "a text for a number": json.dumps(content(metrics={"mse": "0.2"})),
    "NaN": json.dumps(content(metrics={"mse": math.nan})),
    "no interval": json.dumps(content(intervals={})),
    "half an interval": json.dumps(content(intervals={"mse": [0.1]})),
    "no metrics": json.dumps(content(metrics=None)),
    "a path for a name": json.dumps(content(model="../../cophynet")),
    "no MSE": json.dumps(
        content(metrics={"final_position_error": 0.2}, intervals={"final_position_error": [0.1, 0.3]})
    ),
    "a huge count": json.dumps(content(num_test=10**299)),
    "a number beyond floats": json.dumps(content(metrics={"mse": 10**400})),
    "no count": json.dumps(content(num_train=True)),
    "deep": "[" * 100_000,
    "a formula": json.dumps(content(metrics={"mse": 0.2, "=1+1": 1.0})),
    "HTML": json.dumps(content(size="<script>")),
    "a lone surrogate": json.dumps(content(derenderer="\ud800")),
    "a list of changes": json.dumps(content(changes=["hidden_dim"])),
    "a number for a change": json.dumps(content(changes={"hidden_dim": 8})),
    "a formula for a key": json.dumps(content(changes={"=1+1": "8"})),
    "lists for names": json.dumps(content(dataset_ids=[["3-x"]])),
}


@pytest.mark.parametrize("metrics", INVALID.values(), ids=INVALID.keys())
def test_an_invalid_run_is_named_and_skipped(tmp_path: Path, metrics: str, caplog: pytest.LogCaptureFixture) -> None:
    leave(tmp_path / PLACE, metrics)
    leave(tmp_path / PLACE.with_name("seed1"), json.dumps(content(seed=1)))
    assert read_runs(tmp_path)["seed"].tolist() == [1]
    assert f"{PLACE} is skipped: metrics.json" in caplog.text


@pytest.mark.parametrize(
    "changes",
    [
        {"position": np.full((4, 5, 3, 3), np.nan, "f4")},
        {"position": np.full((4, 5, 3, 3), 1e30)},
        {"position": np.zeros((4, 5, 3, 3), np.longdouble)},
        {"presence": np.zeros((4, 3), bool)},
        {"pair": np.zeros(3)},
        {"position": np.array([print])},
        None,
    ],
    ids=["NaN", "huge", "long double", "nobody", "shape", "pickled", "missing"],
)
def test_damaged_predictions_are_named_and_their_run_skipped(
    tmp_path: Path, changes: dict[str, Any] | None, caplog: pytest.LogCaptureFixture
) -> None:
    leave(tmp_path / PLACE, json.dumps(content()))
    path = tmp_path / PLACE / "predictions.npz"
    with np.load(path) as file:
        arrays = dict(file)
    path.unlink()
    if changes is not None:
        np.savez_compressed(path, **(arrays | changes))
    assert read_stored_predictions(read_runs(tmp_path)) == {}
    assert "predictions.npz is missing or damaged" in caplog.text


@pytest.mark.parametrize(
    ("facts", "message"), [({}, ""), ({"num_test": 5}, "test experiments"), ({"metrics": {"mse": 0.2}}, "0.2")]
)
def test_predictions_are_those_of_the_metrics(
    facts: dict[str, Any], message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    leave(tmp_path / PLACE, json.dumps(content(**({"metrics": {"mse": 1.0}} | facts))), error=1.0)
    stored = read_stored_predictions(read_runs(tmp_path))
    assert list(stored) == ([] if message else [tmp_path / PLACE])
    assert message in caplog.text


@pytest.mark.parametrize("name", ["error", "has_begun", "derenderer", "epochs", "directory", "mse_low", "metrics.mse"])
def test_a_metric_of_any_name_is_taken_for_nothing_else(name: str, tmp_path: Path) -> None:
    leave(
        tmp_path / PLACE, json.dumps(content(metrics={"mse": 0.2, name: 7.0}, intervals={"mse": [0, 1], name: [6, 8]}))
    )
    runs = read_runs(tmp_path)
    assert runs["error"].isna().all()
    assert runs.iloc[0][["metrics.mse", "low.mse", f"metrics.{name}", f"low.{name}"]].tolist() == [0.2, 0, 7, 6]
    assert method_cells(runs)["metrics.mse"].tolist() == [0.2]


@pytest.mark.parametrize("error", ["=cmd|'/c calc'!A0", 3, None])
def test_a_failure_that_train_py_did_not_write_is_skipped(error: object, tmp_path: Path) -> None:
    leave_failure(tmp_path / PLACE, error)
    assert read_runs(tmp_path).empty


def test_the_error_of_a_failed_run_is_one_line_that_any_medium_shows(tmp_path: Path) -> None:
    leave_failure(tmp_path / PLACE, "ValueError: \x1b]0;title\x07\x1b[2J a\nb \ud800")
    (error,) = read_runs(tmp_path)["error"]
    assert error == r"ValueError: \x1b]0;title\x07\x1b[2J a b \ud800"


@pytest.mark.parametrize(
    "replace", [lambda path: os.mkfifo(path), lambda path: path.symlink_to("/dev/zero"), Path.mkdir]
)
def test_what_is_no_regular_file_is_skipped(replace: Callable[[Path], None], tmp_path: Path) -> None:
    leave(tmp_path / PLACE, "{}")
    (tmp_path / PLACE / "metrics.json").unlink()
    replace(tmp_path / PLACE / "metrics.json")
    assert read_runs(tmp_path).attrs["unused"] == 1


def test_what_cannot_be_read_is_counted(tmp_path: Path) -> None:
    assert read_runs(tmp_path).attrs["unused"] == 0
    broken = tmp_path / "balls" / "4to4" / "in" / "full" / "ground_truth" / "seed0" / "metrics.json"
    broken.parent.mkdir(parents=True)
    broken.write_text("{}")
    assert read_runs(tmp_path).attrs["unused"] == 1


def test_tables_are_written_before_they_are_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_failure(tmp_path / PLACE, "ValueError: boom")

    def refuse(report: pipeline.Report) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(pipeline.Report, "show", refuse)
    unused: Any = None
    supplement = pipeline.Supplement(figures={"study-a": Figure()})
    configurations = pipeline.Configurations(unused, unused, None, no_dataset)
    with pytest.raises(BrokenPipeError):
        pipeline.write_report(tmp_path, tmp_path / "report", configurations, supplement)
    assert (tmp_path / "report" / "figures" / "study-a.pdf").exists()  # the output is closed, not the files
    assert "ValueError: boom" in (tmp_path / "report" / "runs.csv").read_text()


def test_only_what_an_earlier_report_wrote_is_removed(tmp_path: Path) -> None:
    leave_failure(tmp_path / PLACE, "ValueError: boom")
    figures = tmp_path / "report" / "figures"
    figures.mkdir(parents=True)
    earlier = ["figures/sweep-x-0.5.png", "figures/sweep-x-0.5.pdf", "collision.csv", "difficulty.md"]
    others = ["figures/sweep-mine.png", "figures/mine.png", "figures/mine.pdf", "mine.csv", "comparisons.tex"]
    for name in (*earlier, *others):
        (tmp_path / "report" / name).touch()
    unused: Any = None
    configurations = pipeline.Configurations(unused, unused, None, no_dataset)
    supplement = pipeline.Supplement(figures={"study-a": Figure()})
    pipeline.write_report(tmp_path, tmp_path / "report", configurations, supplement, paper=False)
    left = {path.relative_to(tmp_path / "report").as_posix() for path in (tmp_path / "report").rglob("*.*")}
    written = ["tables.md", "tables.tex", "document.tex", "runs.csv", "methods.csv"]
    assert left == {*others, *written, "figures/study-a.png", "figures/study-a.pdf"}


@pytest.mark.parametrize("below", ["blocktower", "blocktower/3to3", "."])
def test_a_folder_within_that_of_all_runs_is_not_enough(
    below: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("INFO")
    leave(tmp_path / "runs" / PLACE, json.dumps(content()))
    monkeypatch.chdir(tmp_path)
    outputs, unused = Path("runs") / below if below != "." else Path("."), None
    configurations = pipeline.Configurations(unused, unused, None, no_dataset)  # type: ignore[arg-type]
    with pytest.raises(CophyError, match=rf"outputs={outputs}: .* below runs: outputs=runs$"):
        pipeline.write_report(outputs, tmp_path / "report", configurations)
    assert caplog.text == ""
