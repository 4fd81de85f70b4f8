"""Forecasts of the oracles for tiny data."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.features import to_batch
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.oracles.forecasts import ORACLES, OracleForecasts, OracleSettings
from tests.conftest import SCENARIOS, tiny_spec

SETTINGS = OracleSettings(draws=4, max_configurations=8, noise=0.05, max_experiments=4)


@pytest.fixture(scope="module")
def forecasts(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, OracleForecasts]:
    """Forecasts for the first test experiments of every scenario, next to a copy of its tiny dataset."""
    directory, result = tmp_path_factory.mktemp("forecasts"), {}
    shutil.copytree(tiny_data, directory, dirs_exist_ok=True)
    for name in SCENARIOS:
        settings = SETTINGS if name == "collision" else replace(SETTINGS, max_experiments=2)
        result[name] = OracleForecasts(States(tiny_spec(name), directory), settings)
        generation.ensure(result[name], workers=1)
    return result


def test_every_oracle_predicts_the_first_test_experiments(forecasts) -> None:
    for each in forecasts.values():
        stored, arrays = each.load(), each.states.load()
        pair = each.spec.order.pair
        tested = np.unique(pair[arrays["split"] == 2])[: each.settings.max_experiments // 2]
        assert sorted(stored["experiment"].tolist()) == np.flatnonzero(np.isin(pair, tested)).tolist()
        np.testing.assert_array_equal(pair[stored["experiment"]], np.repeat(tested, 2))
        present = arrays["presence"][stored["experiment"], 1]
        for oracle in ORACLES:
            position, variance = stored[f"{oracle}_position"], stored[f"{oracle}_draw_variance"]
            assert (np.abs(position).max(axis=(1, 3))[present] > 0).all()
            assert (variance >= 0).all()
            assert ((stored[f"{oracle}_stable"] >= 0) & (stored[f"{oracle}_stable"] <= 1)).all()


def test_twins_share_forecasts_that_do_not_depend_on_their_confounders(forecasts) -> None:
    for each in forecasts.values():
        stored = each.load()
        for oracle in ("feedforward", "initial_velocity"):
            assert np.array_equal(stored[f"{oracle}_position"][::2], stored[f"{oracle}_position"][1::2])
            assert (stored[f"{oracle}_draw_variance"] > 0).any()
        for oracle in ("confounders", "counterfactual", "double_rate", "jitter"):
            assert not np.array_equal(stored[f"{oracle}_position"][::2], stored[f"{oracle}_position"][1::2])


def test_confounders_determine_towers_which_start_at_rest(forecasts) -> None:
    stored, arrays = forecasts["blocktower"].load(), forecasts["blocktower"].states.load()
    assert np.array_equal(stored["initial_velocity_position"], stored["feedforward_position"])
    assert (stored["confounders_draw_variance"] == 0).all()
    truth = to_batch(arrays, forecasts["blocktower"].spec.scenario).targets.position.numpy()[stored["experiment"]]
    np.testing.assert_array_equal(stored["confounders_position"], truth)  # the simulator itself
    balls = forecasts["balls"].load()
    assert not np.array_equal(balls["initial_velocity_position"], balls["feedforward_position"])
    assert (balls["confounders_draw_variance"] > 0).any()


def test_regenerated_forecasts_have_the_same_bytes(forecasts) -> None:
    each = forecasts["collision"]
    shard = next(shard for shard in range(each.spec.num_shards) if len(each.read(shard)["experiment"]))
    before = each.path(shard).read_bytes()
    each.path(shard).unlink()
    generation.ensure(each, workers=1)
    assert each.path(shard).read_bytes() == before


def test_data_that_other_code_generated_are_refused(forecasts, tmp_path: Path, monkeypatch) -> None:
    each = forecasts["collision"]
    scenario = type(each.spec.scenario)
    original = scenario.twin_pair
    monkeypatch.setattr(
        scenario, "twin_pair", lambda self, n, *, data_seed, pair, simulator, series: original(
            self, n, data_seed=data_seed + 1, pair=pair, simulator=simulator, series=series
        )
    )  # fmt: skip
    shard = next(shard for shard in range(each.spec.num_shards) if len(each.read(shard)["experiment"]))
    with pytest.raises(CophyError, match="was made by other code"):
        each.write(tmp_path / "shard.h5", shard, lambda count: None)


def test_another_stability_threshold_has_its_own_directory(forecasts) -> None:
    every = forecasts["collision"]
    spec = replace(
        every.spec, scenario=replace(every.spec.scenario, task=replace(every.spec.scenario.task, stable_speed=0.5))
    )
    other = OracleForecasts(States(spec, every.states.directory.parents[1]), SETTINGS)
    assert other.states.directory == every.states.directory
    assert other.directory != every.directory


def test_a_limit_on_test_experiments_has_its_own_directory(forecasts, tmp_path: Path) -> None:
    every = forecasts["collision"]
    shutil.copytree(every.states.directory, tmp_path / "collision" / every.states.directory.name)
    few = OracleForecasts(States(tiny_spec("collision"), tmp_path), replace(SETTINGS, max_experiments=2))
    assert few.directory.name != every.directory.name
    generation.ensure(few, workers=1)
    for name, array in few.load().items():
        np.testing.assert_array_equal(array, every.load()[name][:2])
    assert (
        sum(len(few.experiments(shard)) for shard in range(few.spec.num_shards)) == 2
    )  # the total of the progress bar
    enough = OracleForecasts(States(tiny_spec("collision"), tmp_path), replace(SETTINGS, max_experiments=4000))
    assert enough.directory.name == every.directory.name
