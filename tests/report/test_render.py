"""On the terminal no line is too long, and no word and no number is broken."""

import os
import signal

import pandas as pd
import pytest

from cophy.report.paper_tables import paper_tables
from cophy.report.render import Cell, TextTable, filled_only, interval, latex, show, table_cells, to_latex
from cophy.report.runs import notice
from cophy.report.tables import fill
from tests.report.lines import measured

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


def latex_of(cells: pd.DataFrame) -> str:
    return latex(TextTable("x", "title", cells, "50 % of A&B_1"))


def test_latex_has_numbers_then_intervals_then_the_papers() -> None:
    cells = pd.DataFrame(
        {"3→3": [Cell("0.1", "± 0.02", "[0.0, 0.2]", paper="0.3", best=True), Cell("—")]}, index=["Copy C", "drift_2"]
    )
    lines = latex_of(cells).splitlines()
    assert r"\caption{Title. 50 \% of A\&B\_1}" in lines
    start = lines.index(r"Copy C & \textbf{0.1} $\pm$ 0.02 \\")
    assert lines[start + 1 : start + 4] == [
        r" & {\scriptsize [0.0, 0.2]} \\",
        r"\quad the paper's & 0.3 \\",
        r"drift\_2 & -- \\",
    ]


def test_latex_breaks_wide_tables_into_blocks_and_long_ones_into_pages() -> None:
    wide = pd.DataFrame(
        {f"split {n}": [Cell("0.123", "± 0.004")] * 9 for n in range(8)}, index=[f"m{n}" for n in range(9)]
    )
    assert latex_of(wide).count(r"\begin{tabular}") > 1
    long = pd.DataFrame({"all": [Cell("0.123", interval="[0, 1]")] * 90}, index=[f"m{n}" for n in range(90)])
    assert latex_of(long).count(r"\begin{table}") == latex_of(long).count(r"\end{table}") == 3
    assert "scriptsize" not in latex_of(long)
    assert "Intervals are in the CSV file." in latex_of(long)


def test_a_notice_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, notice("a sentence of words " * 20).splitlines())) <= 80


def test_latex_leaves_out_what_failed() -> None:
    cells = pd.DataFrame({"a": [Cell("0.1"), Cell("failed")], "b": [Cell("failed"), Cell("failed")]}, index=["x", "y"])
    text = latex_of(cells)
    assert "failed" not in text
    assert [line for line in text.splitlines() if line.endswith(r"\\")] == [r" & a \\", r"x & 0.1 \\"]
    assert latex_of(cells[["b"]]) == ""


def test_latex_has_minus_signs_and_breaks_keys() -> None:
    cells = pd.DataFrame({"a": [Cell("-28.8", "± 1.0", "[-30.1, -0.5]")]}, index=["copy-2 lr=1e-05 shift=-1"])
    text = latex_of(cells)
    assert r"$-$28.8 $\pm$ 1.0" in text
    assert "[$-$30.1, $-$0.5]" in text
    assert r"copy-2 lr=\allowbreak{}1e-05 shift=\allowbreak{}$-$1" in text
    assert to_latex("collision.2=640, 0.5.") == r"collision.\allowbreak{}2=\allowbreak{}640, 0.5."


def test_long_latex_tables_may_keep_their_intervals() -> None:
    long = pd.DataFrame({"all": [Cell("0.123", interval="[0, 1]")] * 90}, index=[f"m{n}" for n in range(90)])
    text = latex(TextTable("x", "title", long, ""), keep_intervals=True)
    assert text.count("[0, 1]") == 90
    assert text.count(r"\begin{table}") > 3


@pytest.mark.parametrize("label", ["IN (key=[/])", "[bold]", "[64, 64]"])
def test_a_label_is_no_markup(label: str, capsys: pytest.CaptureFixture[str]) -> None:
    cells = pd.DataFrame({"a": [Cell("0.1", best=True)]}, index=[label])
    show("title", cells)
    assert label in capsys.readouterr().out
    assert r"\midrule" + "\n[" not in latex(TextTable("x", "title", cells, ""))


def test_an_interval_has_no_negative_zero() -> None:
    assert interval(-0.0001, 0.2, ".3f") == "[0.000, 0.200]"
    assert interval(-0.001, 0.2, ".0%") == "[0%, 20%]"
    assert interval(0.2, 0.2, ".3f") == interval(float("nan"), 0.2, ".3f") == ""


def test_a_closed_output_ends_the_program_as_it_ends_others(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed, monkeypatch.context() as context:
        context.setattr("sys.stdout", closed)
        with pytest.raises(SystemExit) as end:
            show("A table", pd.DataFrame({"a": [Cell("b")]}, index=["x"]))
    assert end.value.code == 128 + signal.SIGPIPE
