"""On the terminal no line is too long, and no word and no number is broken."""

from typing import Any

import pandas as pd
import pytest

from cophy.report.overview import overviews
from cophy.report.render import BOLD, filled_only, show
from cophy.report.runs import notice
from cophy.report.tables import fill, paper_tables
from tests.report.lines import measured, run

TABLES = {table.id: table for table in paper_tables()}


def names_of(choice: dict[str, str]) -> dict[str, Any]:
    """Without the metric."""
    return {key: value for key, value in choice.items() if key != "metric"}


def full(name: str) -> tuple[str, pd.DataFrame]:
    """A table of the paper in which every cell has a number, three seeds and an interval."""
    table = TABLES[name]
    choices = [
        {**table.select, **row, **column}
        for row in table.rows.values()
        for column in table.columns.values()
        if "people" not in row
    ]
    runs = [
        measured(choice["metric"], 123.456 / table.scale + seed, seed=seed, **names_of(choice))
        for choice in choices
        for seed in range(3)
    ]
    filled = fill(table, pd.DataFrame(runs))
    return table.title, filled.cells(bold=BOLD)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("columns", [80, 140])
def test_a_full_table_fits_and_breaks_nothing(
    name: str, columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    title, cells = full(name)
    show(title, cells, "A caption.")
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= columns
    words = printed.split()
    for heading in (*cells.index, *cells.columns):
        assert set(heading.split()) <= set(words)
    numbers = [cell.replace(BOLD[0], "").replace(BOLD[1], "").split(" ")[0] for cell in cells.to_numpy().flat]
    assert sum(words.count(number) for number in set(numbers)) >= len(numbers)
    assert "BOLD" not in printed
    assert ("[" in printed) <= (columns >= 100)


def test_intervals_are_told_where_there_is_room(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = pd.DataFrame({"Copy C": ["0.700 [0.539, 0.861] / 0.294"]}, index=["3→3"])
    for columns, told in ((80, False), (100, True)):
        monkeypatch.setenv("COLUMNS", str(columns))
        show("A table", cells)
        assert ("0.700 [0.539, 0.861]" in capsys.readouterr().out) is told


def test_empty_rows_and_columns_are_left_out() -> None:
    cells = pd.DataFrame({"a": ["0.1 / 0.2", "— / 0.3"], "b": ["— / 0.2", "— / 0.3"]}, index=["x", "y"])
    assert filled_only(cells).to_dict() == {"a": {"x": "0.1 / 0.2"}}


def test_the_overview_tells_mse_epochs_seeds_and_failures() -> None:
    lines = [
        *(run("cophynet", seed=seed) for seed in range(3)),
        run("cophynet", seed=3, epochs=20),
        run("copy_c", training_seconds=0.0, is_trained=False),
        run("cophynet", split="3to4") | {"error": "broken"},
        run("in", positions="derendered"),
    ]
    found = overviews(pd.DataFrame([line | {"mse": 0.2} for line in lines]))
    assert list(found) == [
        "blocktower, size small, estimated positions",
        "blocktower, size small, true positions",
    ]
    table = found["blocktower, size small, true positions"]
    assert table.loc["cophynet"].to_dict() == {"3to3": "0.200 (20, 40 × 3)", "3to4": "1 failed"}
    assert table.loc["copy_c"].to_dict() == {"3to3": "0.200 (× 1)", "3to4": "—"}


def test_a_notice_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, notice("a sentence of words " * 20).splitlines())) <= 80
