"""MSE by difficulty, from predictions whose errors are known."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from cophy.dataset.features import to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, Part
from cophy.dataset.states import States
from cophy.report.difficulty import EVERYTHING, TITLES, draw, groups, mse_by_difficulty, page
from cophy.report.predictions import stored_scores
from cophy.training.predictor import prediction_arrays
from cophy.training.run import write_predictions
from cophy.types import Prediction
from tests.conftest import tiny_spec
from tests.report.lines import run
from tests.training.scored import scored

SPEC = tiny_spec("blocktower")


@pytest.fixture
def arrays(tiny_data: Path) -> dict[str, np.ndarray]:
    """The tiny towers, as if all were tested on and all twins known."""
    arrays = States(SPEC, tiny_data).load()
    return arrays | {"split": np.full_like(arrays["split"], SPLITS.index("test")), "twin": SPEC.order.pair}


def finished_run(arrays: dict[str, np.ndarray], directory: Path, seed: int = 0, **changes: Any) -> dict[str, Any]:
    """A run whose predictions are off at random, and the line that `read_runs` makes of it."""
    targets = to_batch(arrays, SPEC.scenario).targets
    noise = torch.randn(targets.position.shape, generator=torch.Generator().manual_seed(seed))
    prediction = Prediction(targets.position + noise)
    directory = directory / f"seed{seed}"
    directory.mkdir()
    write_predictions(directory, prediction_arrays(prediction, targets, np.arange(len(targets)), targets.pair.numpy()))
    measured = scored(prediction, targets, SPEC.scenario).means()
    line = run("cophynet", seed=seed, size="tiny", directory=directory, dataset_ids=[SPEC.id], metric_dims=3)
    return line | {f"metrics.{name}": value for name, value in measured.items()} | changes


def broken_down(lines: list[dict[str, Any]], arrays: dict[str, np.ndarray], spec: DatasetSpec = SPEC) -> pd.DataFrame:
    scores = {line["directory"]: stored_scores(line) for line in lines}
    return mse_by_difficulty(pd.DataFrame(lines), scores, arrays, spec, Part(3))


def test_groups_add_up_to_the_mse_of_the_run(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    line = finished_run(arrays, tmp_path)
    found = broken_down([line], arrays)
    assert list(found["by"].unique()) == list(TITLES)
    for by, group in found.groupby("by"):
        assert ((group["low"] <= group["mse"]) & (group["mse"] <= group["high"])).all()
        if by != "displacement":  # removals have none
            assert group["experiments"].sum() == SPEC.num_experiments
            assert np.average(group["mse"], weights=group["experiments"]) == pytest.approx(
                line["metrics.mse"], rel=1e-4
            )
    assert found["experiments"][found["by"] == "cell"].sum() == SPEC.num_experiments


def test_what_is_explained_of_twins_is_as_in_metrics_json_and_given_per_kind_of_pair(
    arrays: dict[str, np.ndarray], tmp_path: Path
) -> None:
    line = finished_run(arrays, tmp_path)
    found = broken_down([line], arrays)
    assert found["explained"][found["by"] == EVERYTHING].tolist() == pytest.approx(
        [line["metrics.twin_difference_explained"]]
    )
    kinds = found[found["by"] == "twins"]
    assert kinds["group"].tolist() == ["both fall falls or both fall stands", "falls falls or stands stands"]
    assert kinds["explained"].notna().all()
    assert found["explained"][found["by"] == "cell"].isna().all()


def test_seeds_are_averaged_per_experiment(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    lines = [finished_run(arrays, tmp_path, seed) for seed in (0, 1)]
    everything = broken_down(lines, arrays).set_index("by").loc[EVERYTHING]
    assert everything["mse"] == pytest.approx(np.mean([line["metrics.mse"] for line in lines]), rel=1e-4)
    assert everything["seeds"] == 2


def test_predictions_of_something_else_are_named(
    arrays: dict[str, np.ndarray], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lines = [finished_run(arrays, tmp_path), finished_run(arrays, tmp_path, seed=1, dataset_ids=["3-small-00000000"])]
    assert set(broken_down(lines, arrays)["seeds"]) == {1}
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert str(tmp_path / "seed1") in record.message


def test_predictions_of_other_experiments_are_named(
    arrays: dict[str, np.ndarray], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    line = finished_run(arrays, tmp_path)
    other = {name: array[::-1] for name, array in arrays.items()}
    assert broken_down([line], other).empty
    assert "seed0: its predictions are not of the test split of 3-tiny" in caplog.text


def test_an_oracle_that_was_asked_about_fewer_is_left_out(
    arrays: dict[str, np.ndarray], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    line = finished_run({name: array[:8] for name, array in arrays.items()}, tmp_path)
    assert broken_down([line], arrays).empty
    assert f"predicted 8 of {SPEC.num_experiments} test experiments" in caplog.text
    assert "run it again" not in caplog.text


def test_thirds_hold_everything_once_and_keep_equal_numbers_together() -> None:
    value = np.array([3.0, 1.0, 2.0, np.nan, 6.0, 5.0, 4.0, 1.0])
    found = {name: rows for by, name, rows in groups({"displacement": value}) if by == "displacement"}
    assert [value[rows].tolist() for rows in found.values()] == [[1, 2, 1], [3, 4], [6, 5]]
    assert list(found) == ["1 to 2", "2 to 4", "4 to 6"]
    tied = np.array([1.0, 1.0, 1.0, 2.0])
    assert [tied[rows].tolist() for _, _, rows in groups({"displacement": tied})] == [[1, 1, 1, 2], [1, 1, 1], [2]]
    assert len(list(groups({"displacement": np.full(4, np.nan)}))) == 1  # all, and no other


def test_page_and_figures_say_what_they_show(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    found = broken_down([finished_run(arrays, tmp_path)], arrays)
    text = page(found, {"blocktower": SPEC.scenario})
    assert "## blocktower, 3to3, tiny" in text
    first = found.iloc[0]
    assert f"{first['mse']:.3f} [{first['low']:.3f}, {first['high']:.3f}]" in text
    ((name, figure),) = draw(found, {"blocktower": SPEC.scenario})
    assert name == "difficulty-blocktower-3to3-tiny"
    titles = [axis.get_title().replace("\n", " ") for axis in figure.axes if axis.axison]
    assert titles == ["cell: outcome of AB, of CD", *list(TITLES.values())[2:]]


def test_an_interval_without_width_is_left_out(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    found = broken_down([finished_run(arrays, tmp_path)], arrays)
    alone = found.assign(low=found["mse"], high=found["mse"])
    alone = alone.assign(explained_low=found["explained"], explained_high=found["explained"])
    tables = page(alone, {"blocktower": SPEC.scenario}).split("##")[1]
    assert f"{found['mse'].iloc[0]:.3f}" in tables
    assert "[" not in tables
