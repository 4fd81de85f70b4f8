"""The tables of the paper that runs can fill, as paper_tables.yaml describes them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any

import yaml


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper.

    Attributes:
        id: Name of its files, and of its sweep in conf/table/.
        title: What it shows.
        select: Names of the runs that fill it, and the metric that is shown.
        rows: Label -> what the row adds to `select`; of a row that people fill, people: the setting.
        columns: Label -> what the column adds.
        paper: The paper's numbers, rows × columns.
        methods: "rows", "columns", or None where nothing competes.
        bounds: Labels of methods that are told more than the others; they do not compete.
        oracles: Labels of the oracles, that without AB first, that with AB last.
        lower_is_better: Of the metric.
        scale: From the metric's unit to the table's.
        digits: After the point.
        note: Goes below it.
        controls: Label -> what it adds to `select`, as of rows; their numbers, which the paper does not have, go below.
        also_derendered: Whether there is the same table with positions that a de-renderer estimates in testing.
    """

    id: str
    title: str
    select: dict[str, str]
    rows: dict[str, dict[str, str]]
    columns: dict[str, dict[str, str]]
    paper: list[list[float | None]]
    methods: str | None
    bounds: list[str] = field(default_factory=list)
    oracles: list[str] = field(default_factory=list)
    lower_is_better: bool = True
    scale: float = 1.0
    digits: int = 3
    note: str = ""
    controls: dict[str, dict[str, str]] = field(default_factory=dict)
    also_derendered: bool = False

    @property
    def ends(self) -> tuple[str, str]:
        """The oracles that the share of the possible gain is 0 % and 100 % for."""
        return self.oracles[0], self.oracles[-1]


def paper_tables() -> list[PaperTable]:
    """All tables of the paper that runs can fill."""
    content = yaml.safe_load((files("cophy.report.tables") / "paper_tables.yaml").read_text())
    tables = [PaperTable(**table) for table in content["tables"]]
    return tables + [_derendered(table) for table in tables if table.also_derendered]


def published_mse(names: Mapping[str, Any]) -> float | None:
    """The MSE that the paper prints for the run of these names; None where it prints none."""
    for table in paper_tables():
        for in_row, printed in zip(table.rows.values(), table.paper, strict=True):
            for in_column, number in zip(table.columns.values(), printed, strict=True):
                wanted = {"positions": "ground_truth", **table.select, **in_row, **in_column}
                if wanted.pop("metric") == "mse" and number is not None and wanted.items() <= names.items():
                    return number
    return None


def _derendered(table: PaperTable) -> PaperTable:
    """The same methods on positions estimated from pictures; oracles see true ones only, people see pictures in any case."""
    rows, columns = (
        {name: keys for name, keys in axis.items() if name not in table.oracles and "people" not in keys}
        for axis in (table.rows, table.columns)
    )
    printed = [numbers for keys, numbers in zip(table.rows.values(), table.paper, strict=True) if "people" not in keys]
    return replace(
        table,
        id=f"{table.id}_derendered",
        title=f"{table.title}; positions estimated from pictures in testing",
        select={**table.select, "positions": "train_ground_truth_test_derendered"},
        rows=rows,
        columns=columns,
        paper=[numbers[: len(columns)] for numbers in printed[: len(rows)]],  # oracles come last
        bounds=[name for name in table.bounds if name in rows or name in columns],
        oracles=[],
        also_derendered=False,
    )
