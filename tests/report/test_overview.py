"""The tables of twins, from runs whose numbers are known."""

import pandas as pd

from cophy.report.overview import twin_tables
from cophy.report.render import Cell
from tests.report.lines import measured, run


def on_twins(model: str, explained: float, right: float, **changes: object) -> dict[str, object]:
    line = measured("twin_difference_explained", explained, model, **changes)
    return line | measured("right_twin_chosen", right, model, **changes)


def test_every_run_on_twins_has_a_line_and_every_tested_split_a_column() -> None:
    runs = [
        on_twins("cophynet", 0.4, 0.7),
        on_twins("cophynet", 0.6, 0.8, seed=1),
        on_twins("in", 0.0, 0.5),
        on_twins("cophynet", 0.2, 0.6, split="3to4"),
        run("copy_b", source="cophy"),
    ]
    explained, right = (table.map(Cell.line) for table in twin_tables(pd.DataFrame(runs)).values())
    assert list(explained.columns) == ["3to3", "3to4"]
    assert explained.loc["cophynet"].tolist() == ["50.0 % ± 14.1 [49.0, 52.0]", "20.0 % [19.0, 22.0]"]
    assert right.loc["in"].tolist() == ["50.0 % [49.0, 52.0]", "—"]
    assert "copy_b" not in explained.index


def test_twins_of_the_longest_training_are_shown() -> None:
    runs = [on_twins("cophynet", 0.4, 0.7, epochs=15), on_twins("cophynet", 0.0, 0.5, epochs=5)]
    explained, _ = (table.map(Cell.line) for table in twin_tables(pd.DataFrame(runs)).values())
    assert explained.loc["cophynet"].tolist() == ["40.0 % [39.0, 42.0]"]


def test_without_twins_there_is_no_table() -> None:
    assert twin_tables(pd.DataFrame([measured("mse", 0.2, "cophynet")])) == {}
    assert twin_tables(pd.DataFrame()) == {}
    failed = run("cophynet", error="broken", right_twin_chosen=float("nan"), twin_difference_explained=float("nan"))
    assert twin_tables(pd.DataFrame([failed])) == {}
