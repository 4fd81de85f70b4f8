"""Leaderboard entries: those of the repository are valid, and faults get one line."""

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import cophy
from cophy.commands.score import leaderboard_lines
from cophy.training.run import Run
from tests.conftest import ROOT
from tests.test_scoring import along_x, four


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("result_entries")


def score(**changes: Any) -> dict[str, Any]:
    return {
        "scenario": "collision",
        "split": "all",
        "size": "small",
        "data_seed": 0,
        "seed": 0,
        "positions": "ground_truth",
        "sha256": "0a" * 32,
        "num_test": 400,
        "mse": [0.5, 0.4, 0.6],
        "twin_difference_explained": [0.2, -0.1, 0.3],
        "right_twin_chosen": [0.7, 0.6, 0.8],
    } | changes


def entry(**changes: Any) -> dict[str, Any]:
    return {
        "name": "A rule",
        "code": "https://example.org/rule",
        "sees": ["AB", "C"],
        "parameters": 0,
        "scores": [score()],
    } | changes


def without(content: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in content.items() if name != key}


FAULTS: dict[str, tuple[Any, str]] = {
    "not a dictionary": ([1, 2], "the file has no keys"),
    "nothing": (None, "the file has no keys"),
    "an unknown key": (entry(rank=1), "rank: there is no such key"),
    "no name": (without(entry(), "name"), "name is missing"),
    "a name with HTML": (entry(name="<b>best</b>"), "name: letters"),
    "a name that is a number": (entry(name=5), "name: letters"),
    "no address": (entry(code="see my page"), "code: no address"),
    "a script as address": (entry(code="javascript:alert(1)"), "code: no address"),
    "an address with Markdown": (entry(paper="https://x.org/)[y](z"), "paper: no address"),
    "sees the outcome": (entry(sees=["AB", "D"]), "sees: a list of some of"),
    "sees nothing": (entry(sees=[]), "sees: a list of some of"),
    "parameters in words": (entry(parameters="many"), "parameters: no number"),
    "no scores": (entry(scores=[]), "scores: no list"),
    "a score without a key": (entry(scores=[without(score(), "sha256")]), "scores[0].sha256 is missing"),
    "a score with another key": (entry(scores=[score(rank=1)]), "scores[0].rank: there is no such key"),
    "another scenario": (entry(scores=[score(scenario="cars")]), "scores[0].scenario: none of"),
    "a split of another scenario": (entry(scores=[score(split="3to3")]), "scores[0].split: none of"),
    "an unknown size": (entry(scores=[score(size="tiny")]), "scores[0].size: neither small nor paper"),
    "a short hash": (entry(scores=[score(sha256="0a")]), "scores[0].sha256: not the 64"),
    "a number without interval": (entry(scores=[score(mse=0.5)]), "scores[0].mse: not [mean, low, high]"),
    "a mean outside its interval": (entry(scores=[score(mse=[0.7, 0.4, 0.6])]), "scores[0].mse: not [mean, low"),
    "NaN": (entry(scores=[score(mse=[float("nan")] * 3)]), "scores[0].mse: not [mean, low"),
    "a negative MSE": (entry(scores=[score(mse=[-1.0, -2.0, 0.0])]), "scores[0].mse: not [mean, low"),
    "more than all": (entry(scores=[score(right_twin_chosen=[2.0] * 3)]), "scores[0].right_twin_chosen: not"),
    "a seed in words": (entry(scores=[score(seed="0")]), "scores[0].seed: no number"),
    "the same run twice": (entry(scores=[score(), score()]), "scores[1]: another one has the same"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_get_one_line(fault: str, entries: ModuleType, tmp_path: Path) -> None:
    content, message = FAULTS[fault]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(entries.EntryError) as error:
        entries.read_entry(path)
    assert str(error.value).startswith("mine.yaml: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


FILES: dict[str, Callable[[Path], object]] = {
    "no YAML": lambda path: path.write_text("name: [unclosed"),
    "a Python object": lambda path: path.write_text("!!python/object/apply:os.system ['true']"),
    "no text": lambda path: path.write_bytes(b"\xff\xfe\x00"),
    "large": lambda path: path.write_text("#" * (1 << 17)),
    "a link": lambda path: path.symlink_to(ROOT / "README.md"),
    "deep": lambda path: path.write_text("[" * 20000),
}


@pytest.mark.parametrize("fault", FILES)
def test_other_files_get_one_line(fault: str, entries: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    FILES[fault](path)
    with pytest.raises(entries.EntryError, match=r"^mine\.yaml: [^\n]+$"):
        entries.read_entry(path)


def test_two_entries_have_two_names(entries: ModuleType, tmp_path: Path) -> None:
    for name in ("one.yaml", "two.yaml"):
        (tmp_path / name).write_text(yaml.safe_dump(entry()))
    with pytest.raises(entries.EntryError, match=r"two.yaml: name=A rule is that of another file"):
        entries.read_entries(tmp_path)


def test_the_entries_of_the_repository_are_valid(entries: ModuleType) -> None:
    assert entries.read_entries()


def test_seeds_are_averaged(entries: ModuleType) -> None:
    assert entries._cell([[1.0, 0.5, 2.0], [3.0, 2.0, 4.0]], 2) == "2.00 ±1.41"
    assert entries._cell([[1.0, 0.5, 2.0]], 2) == "1.00 ±0.75"


def test_what_the_command_prints_is_part_of_an_entry(entries: ModuleType, tmp_path: Path) -> None:
    run = Run("collision", "all", "mine", "full", "ground_truth", 3, "small", "", tmp_path)
    scores = cophy.score(along_x(0.0, 1.0, 2.0, 3.0), four())
    lines = leaderboard_lines(run, 1, {"predictions": "0b" * 32, "num_test": 4}, scores)
    content = entry(scores=yaml.safe_load(lines.partition("\n")[2]))
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
    (printed,) = entries.read_entry(tmp_path / "mine.yaml").scores
    assert (printed.seed, printed.data_seed, printed.num_test) == (3, 1, 4)
    assert printed.mse[0] == pytest.approx(scores.means()["mse"], rel=1e-5)
