"""The tables of the paper."""

from cophy.report.tables import paper_tables


def test_tables_are_rectangular_and_their_bounds_exist() -> None:
    for table in paper_tables():
        assert len(table.paper) == len(table.rows)
        assert all(len(row) == len(table.columns) for row in table.paper)
        assert set(table.bounds) <= {*table.rows, *table.columns}
