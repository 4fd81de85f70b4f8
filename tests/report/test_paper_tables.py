"""The sweep of a table runs what the table shows."""

import itertools
from functools import cache
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from cophy.config import CONF
from cophy.oracles.forecasts import ORACLES
from cophy.report.paper_tables import PaperTable, methods, paper_tables
from tests.commands import train
from tests.conftest import quick_first


@cache
def choices_of(row: str) -> tuple[str, str]:
    """Model and ablation that a row chooses."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        choices = compose("train", [f"+row={row}"], return_hydra_config=True).hydra.runtime.choices
    return choices["model"], choices["ablation"]


@pytest.mark.parametrize("table", quick_first(paper_tables(), 3), ids=lambda table: table.id)
def test_the_sweep_of_a_table_runs_what_its_cells_show(table: PaperTable) -> None:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", [f"+table={table.id}"], return_hydra_config=True)
    params = {key: str(value).split(",") for key, value in cfg.hydra.sweeper.params.items()}
    assert params.keys() <= {"scenario", "split", "model", "+row", "positions"}
    models = [choices_of(row) for row in params["+row"]]
    positions = params.get("positions", [cfg.positions])
    product = itertools.product(params["scenario"], params["split"], models, positions)
    swept = {(scenario, split, *method, seen) for scenario, split, method, seen in product}
    controls = itertools.product(table.controls.values(), table.columns.values())
    cells = [names for _, _, names, _ in table.cells() if "participants" not in names]
    cells += [{"positions": "ground_truth", **table.select, **row, **column} for row, column in controls]
    names = ("scenario", "split", "model", "ablation", "positions")
    shown = {tuple(cell[name] for name in names) for cell in cells}
    assert shown <= swept
    assert {model for _, _, model, _, _ in swept - shown} <= {"copy_c", "copy_b"}  # what costs no training


def test_every_method_is_a_choice() -> None:
    """Rows are composed where an ablation changes another model than CoPhyNet; test_config.py has those of CoPhyNet."""
    rows = [method for method in methods().values() if method.model is not None]
    choices = {("model", row.model) for row in rows} | {("ablation", row.ablation) for row in rows}
    assert [f"{group}/{name}" for group, name in choices if not (CONF / group / f"{name}.yaml").exists()] == []
    changed = {row.name: row for row in rows if row.ablation != "full" and row.model != "cophynet"}
    assert changed.keys() == {"in_sup", "in_without_pose"}
    for name, row in changed.items():
        assert choices_of(name) == (row.model, row.ablation)


@pytest.mark.parametrize("scenario", ["blocktower", "balls", "collision"])
def test_every_split_of_a_table_is_tested_by_every_oracle(scenario: str) -> None:
    """So that no column of oracles stays empty."""
    table = next(table for table in paper_tables() if table.id == scenario)
    tested = {row["split"] for row in table.rows.values()}
    oracles = {method.model for method in table.methods.values() if method.simulates}
    names = {"double_rate": "noise_floor_rate", "jitter": "noise_floor_jitter"}
    assert oracles == {names.get(oracle, f"oracle_{oracle}") for oracle in ORACLES}
    with initialize_config_dir(str(CONF), version_base="1.3"):
        params = compose("train", [f"+table={scenario}"], return_hydra_config=True).hydra.sweeper.params
    assert tested <= set(params["split"].split(","))
    assert oracles <= set(params["+row"].split(","))


@pytest.mark.slow
def test_a_table_is_reduced_by_overrides(tiny_data: Path, tmp_path: Path) -> None:
    part = ("+table=collision", "split=all", "+row=copy_b,copy_c", "seed=0,1", f"hydra.sweep.dir={tmp_path}")
    train(*part, data=tiny_data)
    found = {(path.parts[-6], path.parts[-5], path.parts[-2]) for path in tmp_path.rglob("metrics.json")}
    places = [f"seed{seed}+size-tiny+max_epochs-1" for seed in (0, 1)]
    assert found == {("all", model, place) for model in ("copy_b", "copy_c") for place in places}
