"""Filled tables as text."""

import pandas as pd
import pytest

from cophy.report.render import latex, markdown
from cophy.report.tables import fill, paper_tables
from tests.report.lines import measured

TABLES = {table.id: table for table in paper_tables()}


@pytest.mark.parametrize("table", TABLES)
def test_every_format_shows_the_number(table: str) -> None:
    choice = {
        **TABLES[table].select,
        **next(row for row in TABLES[table].rows.values() if "people" not in row),
        **next(iter(TABLES[table].columns.values())),
    }
    metric = choice.pop("metric")
    runs = pd.DataFrame([measured(metric, 0.123, **{**choice, "seed": 0})])
    filled = fill(TABLES[table], runs)
    shown = f"{0.123 * TABLES[table].scale:.{TABLES[table].digits}f}"
    for text in (markdown(filled), latex(filled)):
        assert shown in text
        assert "BOLD" not in text
    assert not set("→†±—").intersection(latex(filled))
