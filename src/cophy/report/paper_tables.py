"""The paper's tables and the methods in them, as paper_tables.yaml describes them.

The same description is what `python src/train.py +table=<id>` and `+row=<method>` run.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import yaml
from hydra.core.config_store import ConfigStore

from cophy.training.run import short_keys

TRUE_POSITIONS, ESTIMATED_IN_TESTING = "ground_truth", "train_ground_truth_test_derendered"
SIMULATED = ("oracle_", "noise_floor")  # how the names of models of cophy.oracles begin


@dataclass(frozen=True)
class Method:
    """A method in the paper's tables, or beyond them.

    Attributes:
        name: As on the command line, `+row=<name>`.
        title: As in tables.
        model, ablation: What it runs; model is None for human participants.
        participants: The setting in which human participants answered, see `cophy.study`.
        competes: Whether it sees what the paper's model sees; only such methods can be the best of a table.
    """

    name: str
    title: str
    model: str | None = None
    ablation: str = "full"
    participants: str | None = None
    competes: bool = True

    @property
    def is_oracle(self) -> bool:
        """Whether it is one of the oracles of docs/benchmark/metrics.md."""
        return self.model is not None and self.model.startswith("oracle_")

    @property
    def simulates(self) -> bool:
        """Whether it is an oracle or a noise floor (`cophy.oracles`), always from true positions."""
        return self.model is not None and self.model.startswith(SIMULATED)

    def keys(self) -> dict[str, str]:
        """Return what a row or column of the method adds to the names of its runs."""
        if self.model is None:
            return {"participants": str(self.participants)}
        return {"model": self.model, "ablation": self.ablation} | (
            {"positions": TRUE_POSITIONS} if self.simulates else {}
        )


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper.

    Attributes:
        id: Name of its files, and of its sweep.
        title: What it shows.
        select: Names of the runs that fill it, and the metric.
        rows, columns: Label -> what a row or column adds to `select`.
        paper: The paper's numbers, rows × columns; None where it has none.
        methods_in: "rows", "columns", or None where nothing is compared.
        methods: Label -> method, along that axis.
        lower_is_better: Whether a lower metric is better.
        scale: Factor from the metric's unit to the table's.
        digits: Digits after the point.
        note: Printed below the table.
        controls: Label -> what further rows add to `select`; their numbers, which the paper does not have, go into the caption.
    """

    id: str
    title: str
    select: dict[str, str]
    rows: dict[str, dict[str, str]]
    columns: dict[str, dict[str, str]]
    paper: list[list[float | None]]
    methods_in: str | None
    methods: dict[str, Method]
    lower_is_better: bool = True
    scale: float = 1.0
    digits: int = 3
    note: str = ""
    controls: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def oracles(self) -> list[str]:
        """The labels of the oracles: the one without AB first, the one with AB last."""
        return [label for label, method in self.methods.items() if method.is_oracle]

    def cells(self) -> Iterator[tuple[str, str, dict[str, str], float | None]]:
        """Yield row, column, the names of the runs with the metric, and the paper's number of every cell."""
        for (row, in_row), numbers in zip(self.rows.items(), self.paper, strict=True):
            for (column, in_column), number in zip(self.columns.items(), numbers, strict=True):
                yield row, column, {"positions": TRUE_POSITIONS, **self.select, **in_row, **in_column}, number

    def sweep(self) -> dict[str, str]:
        """Return the parameters of the sweep whose runs fill the table: every method on every split."""
        cells = [names for _, _, names, _ in self.cells()] + list(self.controls.values())
        sweep = {"scenario": self.select["scenario"], "split": _joined(cells, "split")}
        methods = {method.name: None for method in self.methods.values() if method.model} or {"cophynet": None}
        positions = _joined([names for names in cells if not names.get("model", "").startswith(SIMULATED)], "positions")
        return sweep | {"+row": ",".join(methods)} | ({"positions": positions} if positions != TRUE_POSITIONS else {})


def _joined(cells: list[dict[str, str]], name: str) -> str:
    return ",".join(dict.fromkeys(names[name] for names in cells if name in names))


@cache
def methods() -> dict[str, Method]:
    """Return all methods by name."""
    return {name: Method(name, **keys) for name, keys in _description()["methods"].items()}


def method_title(model: str, ablation: str = "full", changes: Mapping[str, str] | None = None) -> str:
    """Return the printed name of a method: that of the paper's tables, or one made of the names of model and ablation.

    Args:
        changes: What the method changes beyond these, key -> value. Keys are shortened to their last word where it is unique.
    """
    titles = {(method.model, method.ablation): method.title for method in methods().values()}
    title = titles.get((model, ablation))
    if title is None:
        title = titles.get((model, "full"), model)
        title = title if ablation == "full" else f"{title}, {ablation.replace('_', ' ')}"
    if not changes:
        return title
    return f"{title} ({', '.join(f'{key}={changes[name]}' for name, key in short_keys(changes).items())})"


@cache
def paper_tables() -> tuple[PaperTable, ...]:
    """Return all tables of the paper that runs can fill, those on estimated positions last."""
    tables = [_table(**description) for description in _description()["tables"]]
    estimated = [
        _table(**description, estimated=True)
        for description in _description()["tables"]
        if description.get("also_derendered")
    ]
    return (*tables, *estimated)


def published_mse(names: Mapping[str, Any]) -> float | None:
    """Return the MSE that the paper prints for the run of these names; None where it prints none."""
    for table in paper_tables():
        for _, _, cell, number in table.cells():
            wanted = dict(cell)
            if wanted.pop("metric") == "mse" and number is not None and wanted.items() <= names.items():
                return number
    return None


def register_tables() -> None:
    """Make the groups `row` (one method) and `table` (the sweep of one table) known to Hydra."""
    store = ConfigStore.instance()
    for method in methods().values():
        if method.model is not None:
            overrides = [{"override /model": method.model}, {"override /ablation": method.ablation}]
            store.store(group="row", name=method.name, node={"defaults": overrides}, package="_global_")
    for table in paper_tables():
        sweep = {"hydra": {"mode": "MULTIRUN", "sweeper": {"params": table.sweep()}}}
        store.store(group="table", name=table.id, node=sweep, package="_global_")


@cache
def _description() -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((files("cophy.report") / "paper_tables.yaml").read_text("utf-8"))
    return content


def _table(
    *,
    id: str,
    title: str,
    select: dict[str, str],
    rows: Any,
    columns: Any,
    paper: list[list[float]],
    also_derendered: bool = False,
    estimated: bool = False,
    **others: Any,
) -> PaperTable:
    """Return the table of a description; if `estimated`, on positions that a de-renderer estimates in testing.

    Oracles see true positions only, and human participants see images in any case, so both are left out then.
    """
    axes = {"rows": _axis(rows), "columns": _axis(columns)}
    numbers = {
        (row, column): number
        for row, line in zip(axes["rows"], paper, strict=False)  # rows and columns without numbers come last
        for column, number in zip(axes["columns"], line, strict=False)
    }
    if estimated:
        id, title = f"{id}_derendered", f"{title}; positions estimated from images in testing"
        select = select | {"positions": ESTIMATED_IN_TESTING}
        for name, axis in axes.items():
            axes[name] = {
                label: (keys, method)
                for label, (keys, method) in axis.items()
                if method is None or not (method.simulates or method.participants)
            }
    compared = {
        name: {label: method for label, (_, method) in axis.items() if method is not None}
        for name, axis in axes.items()
    }
    methods_in = next((name for name, of_axis in compared.items() if of_axis), None)
    return PaperTable(
        id=id,
        title=title,
        select=select,
        rows={label: keys for label, (keys, _) in axes["rows"].items()},
        columns={label: keys for label, (keys, _) in axes["columns"].items()},
        paper=[[numbers.get((row, column)) for column in axes["columns"]] for row in axes["rows"]],
        methods_in=methods_in,
        methods=compared[methods_in] if methods_in else {},
        **others,
    )


def _axis(entries: list[str] | dict[str, dict[str, str]]) -> dict[str, tuple[dict[str, str], Method | None]]:
    """Return label -> (keys, method) of names of methods, or of labels with their keys."""
    if isinstance(entries, list):
        return {methods()[name].title: (methods()[name].keys(), methods()[name]) for name in entries}
    axis = {}
    for label, keys in entries.items():
        method = methods()[keys["method"]] if "method" in keys else None
        others = {name: value for name, value in keys.items() if name != "method"}
        axis[label] = ((method.keys() if method else {}) | others, method)
    return axis
