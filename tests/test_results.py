"""Tables, plots and claims of the documentation are those of the tables in docs/results."""

import csv
import hashlib
import importlib
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest

from cophy.training.checkpoints import read_checkpoint, read_file
from tests.conftest import ROOT

TABLE = ROOT / "docs" / "results" / "results.csv"
COLLISION = {
    "scenario": "collision",
    "split": "all",
    "model": "alongside",
    "ablation": "full",
    "positions": "ground_truth",
    "size": "small",
    "variant": "",
    "seed": "0",
}


@pytest.fixture
def generate(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("generate")


def differences(generate: ModuleType, table: Path) -> Iterator[str]:
    results = generate.Results(table)
    yield from generate.update_pages(results, check=True)
    yield from generate.update_plots(results, check=True)


def changed(path: Path, mse: str, names: dict[str, str] = COLLISION, **others: str) -> Path:
    """A copy of results.csv in which the runs of these names have another MSE, and other columns."""
    runs = pd.read_csv(TABLE, dtype=str, keep_default_na=False)
    chosen = (runs[list(names)] == pd.Series(names)).all(axis=1)
    assert chosen.sum() == 1
    runs.loc[chosen, ["mse", *others]] = [mse, *others.values()]
    runs.to_csv(path, index=False)
    return path


def test_what_is_generated_is_of_results_csv(generate: ModuleType) -> None:
    assert list(differences(generate, TABLE)) == [], "run: python docs/generate.py"


def test_a_changed_number_is_found_in_every_table_and_plot(generate: ModuleType, tmp_path: Path) -> None:
    found = set(differences(generate, changed(tmp_path / "results.csv", "0.5")))
    assert {
        "docs/benchmark/leaderboard.md: leaderboard_collision",
        "docs/benchmark/leaderboard.md: ratio_to_copy_c",
        "docs/cophy/tables.md: collision_full",
        "docs/cophy/tables.md: data_seeds",
        "docs/cophy/tables.md: learning_curves",
        "docs/figures/cost.png",
        "docs/figures/leaderboard.png",
        "docs/figures/learning_curves.png",
    } <= found
    assert not any("blocktower" in name or "balls" in name or "paper" in name for name in found)


def test_the_command_rewrites_what_differs(
    generate: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (
        "README.md",
        "checkpoints/README.md",
        "checkpoints/index.csv",
        "docs/results/results.csv",
        "docs/benchmark/leaderboard.md",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tmp_path / name)
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    results = generate.Results(changed(tmp_path / "results.csv", "0.5"))
    assert list(generate.update_pages(results, check=True)) == list(generate.update_pages(results, check=False))
    assert list(generate.update_pages(results, check=True)) == []
    assert "0.201³" in (tmp_path / "docs/benchmark/leaderboard.md").read_text()


def test_an_unknown_block_is_named(generate: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("README.md", "checkpoints/README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("<!-- generated: none -->\n<!-- end of generated: none -->\n")
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    with pytest.raises(SystemExit, match=r"README\.md: no generated block none; there are leaderboard_blocktower"):
        list(generate.update_pages(generate.Results(TABLE), check=True))


def test_seeds_on_other_data_are_not_averaged(generate: ModuleType, tmp_path: Path) -> None:
    results = generate.Results(changed(tmp_path / "results.csv", "0.5", datasets="2-old"))
    with pytest.raises(SystemExit, match="several datasets"):
        results.cell("mse", "collision", "all", "alongside")


def test_a_run_that_changes_more_is_not_averaged_with_one_that_does_not(generate: ModuleType, tmp_path: Path) -> None:
    runs = pd.read_csv(TABLE, dtype=str, keep_default_na=False)
    names = {
        "scenario": "collision",
        "split": "all",
        "model": "copy_c",
        "positions": "train_ground_truth_test_derendered",
    }
    estimated = runs[(runs[list(names)] == pd.Series(names)).all(axis=1)]
    assert estimated["variant"].str.startswith("+derenderer-").all()
    pd.concat([runs, estimated.assign(variant="", mse="7.5")]).to_csv(tmp_path / "results.csv", index=False)
    cell = generate.Results(tmp_path / "results.csv").cell(
        "mse", "collision", "all", "copy_c", positions=names["positions"]
    )
    assert (cell.value, cell.seeds) == (7.5, 1)


def test_a_comparison_counts_clear_differences(generate: ModuleType, tmp_path: Path) -> None:
    claims: Any = importlib.import_module("result_claims")
    better = {"method": "alongside", "than": ["cophynet"], "columns": ["collision all", "balls 4to4"]}
    worse = {"method": "cophynet", "than": ["alongside"], "columns": ["collision"]}
    results = generate.Results(TABLE)
    assert claims.compared(results, **better) == {"counts": "2 for", "verdict": "reproduced"}
    assert claims.compared(results, **worse) == {"counts": "3 against", "verdict": "not reproduced"}
    one_seed_failed = generate.Results(changed(tmp_path / "results.csv", "9", mse_low="8", mse_high="10"))
    assert claims.compared(one_seed_failed, **better) == {"counts": "1 for, 1 open", "verdict": "cannot be told"}
    assert claims.compared(one_seed_failed, **worse) == {"counts": "2 against, 1 open", "verdict": "not reproduced"}


def test_of_a_share_the_higher_is_better(generate: ModuleType) -> None:
    claims: Any = importlib.import_module("result_claims")
    names = {"method": "alongside", "than": ["cophynet"], "columns": ["collision all"]}
    assert claims.compared(generate.Results(TABLE), **names, measure="share")["verdict"] == "reproduced"


def test_the_interval_of_a_comparison_covers_all_seeds(generate: ModuleType, tmp_path: Path) -> None:
    """Alongside is apart from CoPhyNet in the mean of its intervals, but not in one of its seeds."""
    claims: Any = importlib.import_module("result_claims")
    results = generate.Results(changed(tmp_path / "results.csv", "0.06", mse_low="0.05", mse_high="0.16"))
    place = ["collision", "all"]
    one, two = (results.cell("mse", *place, name) for name in ("alongside", "cophynet"))
    assert one.high < two.low < one.highest
    assert claims.side(results, "mse", "alongside", "cophynet", place, {}) == 0


def test_every_verdict_is_one_of_three(generate: ModuleType) -> None:
    claims: Any = importlib.import_module("result_claims")
    page = (ROOT / "docs" / "cophy" / "claims.md").read_text()
    tables = page[page.index("## Claims about models") :]
    assert {*re.findall(r"\| ([^|]*) \|$", tables, re.MULTILINE)} - {"verdict"} == set(claims.VERDICTS)


def test_every_column_has_a_meaning() -> None:
    with (ROOT / "docs" / "results" / "columns.csv").open(newline="") as lines:
        meanings = {line["column"]: line["meaning"] for line in csv.DictReader(lines)}
    assert list(meanings) == list(pd.read_csv(TABLE, nrows=0).columns)
    assert all(meanings.values())


def test_the_table_has_no_negative_zero() -> None:
    assert not pd.read_csv(TABLE, dtype=str, keep_default_na=False).isin(["-0", "-0.0"]).any(axis=None)


def test_the_hashes_of_published_weights_are_true() -> None:
    with (ROOT / "checkpoints" / "index.csv").open(newline="") as lines:
        hashes = {line["file"]: line["sha256"] for line in csv.DictReader(lines)}
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (ROOT / "checkpoints").glob("*.ckpt")}
    assert hashes == files


def test_published_weights_name_no_folder_of_the_machine_that_trained_them() -> None:
    for path in (ROOT / "checkpoints").glob("*.ckpt"):
        assert "outputs" not in read_checkpoint(read_file(path), path).origin["source"], path
