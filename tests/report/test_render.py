"""On the terminal no line is too long, and no word and no number is broken."""

import pandas as pd
import pytest

from cophy.report.overview import overview_tables
from cophy.report.paper_tables import paper_tables
from cophy.report.render import Cell, filled_only, show, table_cells
from cophy.report.runs import notice
from cophy.report.tables import fill
from tests.report.lines import measured, run

TABLES = {table.id: table for table in paper_tables()}


def full(name: str) -> tuple[str, pd.DataFrame]:
    """A table of the paper in which every cell has a number, three seeds and an interval."""
    table, runs = TABLES[name], []
    for _, _, names, _ in table.cells():
        if "participants" not in names:
            metric = names.pop("metric")
            runs += [measured(metric, 123.456 / table.scale + seed, seed=seed, **names) for seed in range(3)]
    return table.title, table_cells(fill(table, pd.DataFrame(runs)))


@pytest.mark.parametrize("name", ["human_comparison", "blocktower", "confounder_impact", "training_positions"])
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
    numbers = [cell.ours for cell in cells.to_numpy().flat]
    assert sum(words.count(number) for number in set(numbers)) >= len(numbers)
    assert ("[" in printed) <= (columns >= 100)


def test_intervals_are_told_where_there_is_room(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = pd.DataFrame({"Copy C": [Cell("0.700", interval="[0.539, 0.861]", paper="0.294")]}, index=["3→3"])
    for columns, told in ((80, False), (100, True)):
        monkeypatch.setenv("COLUMNS", str(columns))
        show("A table", cells)
        assert ("0.700 [0.539, 0.861]" in capsys.readouterr().out) is told


def test_empty_rows_and_columns_are_left_out() -> None:
    cells = pd.DataFrame({"a": [Cell("0.1"), Cell("—")], "b": [Cell("—"), Cell("—")]}, index=["x", "y"])
    assert filled_only(cells).to_dict() == {"a": {"x": Cell("0.1")}}


def test_the_overview_tells_mse_epochs_seeds_and_failures() -> None:
    lines = [
        *(run("cophynet", seed=seed) for seed in range(3)),
        run("cophynet", seed=3, epochs=20),
        run("copy_c", training_seconds=0.0, is_trained=False),
        run("cophynet", split="3to4") | {"error": "broken"},
        run("in", positions="derendered"),
    ]
    found = overview_tables(pd.DataFrame([line | {"metrics.mse": 0.2} for line in lines]))
    assert list(found) == [
        "blocktower, size small, estimated positions",
        "blocktower, size small, true positions",
    ]
    table = found["blocktower, size small, true positions"]
    assert table.loc["cophynet"].map(Cell.line).to_dict() == {"3to3": "0.200 (20, 40 × 3)", "3to4": "1 failed"}
    assert table.loc["copy_c"].map(Cell.line).to_dict() == {"3to3": "0.200 (× 1)", "3to4": "—"}


def test_a_notice_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, notice("a sentence of words " * 20).splitlines())) <= 80
