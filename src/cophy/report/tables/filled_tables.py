"""A table of the paper with our numbers: each cell ours, with the paper's beside it."""

from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.report.runs.comparable import of_seeds
from cophy.report.tables.captions import caption
from cophy.report.tables.paper_tables import PaperTable
from cophy.report.tables.shares import UNKNOWN, ErrorsOf, Share, share_of_gain

MISSING, FAILED = "—", "failed"
NUMBERS = ("ours", "sd", "low", "high")
PEOPLE = "people"  # key of a row that people fill


class Choice(NamedTuple):
    """What fills a cell: the runs of these names, or the people of a setting."""

    row: str
    column: str
    metric: str
    people: str
    names: dict[str, str]


@dataclass(frozen=True)
class FilledTable:
    """A paper table with our numbers.

    Attributes:
        table: The paper's.
        values: One line per cell, in the table's own unit: row, column, ours, sd over seeds, low and high of the 95 %
            interval, seeds, failed, paper, best; and share of the possible gain with its interval, see `shares`.
        caption: What the cells are, and of which runs.
        left_out: A sentence on runs of smaller sizes, which are in no cell; "" where there are none.
    """

    table: PaperTable
    values: pd.DataFrame
    caption: str
    left_out: str

    @property
    def has_runs(self) -> bool:
        """Whether any of its rows was run here, or tried."""
        return bool(self.values[["seeds", "failed"]].to_numpy().any())

    def cells(self, bold: tuple[str, str] = ("", "")) -> pd.DataFrame:
        """To read: rows × columns of "ours / the paper's", the best between the two strings of `bold`."""
        texts = pd.Series([self._text(value, bold) for value in self.values.to_dict("records")])
        return self._wide(texts, list(self.table.rows), list(self.table.columns))

    def shares(self) -> pd.DataFrame | None:
        """The share in % of the possible gain, (oracle without AB - ours) / (oracle without AB - oracle with AB).

        None where it is known of no method: the table has no oracles, or these were not run, or on other experiments.
        """
        methods = ~self.values[["row", "column"]].isin(self.table.oracles).any(axis=1)
        if self.values.loc[methods, "share"].isna().all():
            return None
        texts = pd.Series([_share_text(value) for value in self.values.to_dict("records")])
        rows, columns = (
            [name for name in names if name not in self.table.oracles]
            for names in (self.table.rows, self.table.columns)
        )
        return self._wide(texts, rows, columns)

    def _wide(self, texts: "pd.Series[str]", rows: list[str], columns: list[str]) -> pd.DataFrame:
        """One text per line of `values`, as rows × columns."""
        wide = self.values.assign(text=texts).pivot(index="row", columns="column", values="text")
        wide = wide.loc[rows, columns]
        wide.columns.name = wide.index.name = None
        return wide

    def _text(self, value: dict[Any, Any], bold: tuple[str, str]) -> str:
        def number(x: float) -> str:
            return f"{round(x, self.table.digits) + 0.0:.{self.table.digits}f}"  # no -0.000

        paper = MISSING if pd.isna(value["paper"]) else number(value["paper"])
        if not value["seeds"]:
            return f"{FAILED if value['failed'] else MISSING} / {paper}"
        varies = value["seeds"] > 1 and float(number(value["sd"])) > 0  # copies are the same whatever the seed
        deviation = f"± {number(value['sd'])} " if varies else ""
        spread = f"{deviation}[{number(value['low'])}, {number(value['high'])}]"
        failed = f" ({value['failed']} failed)" if value["failed"] else ""
        start, end = bold if value["best"] else ("", "")
        return f"{start}{number(value['ours'])}{end} {spread}{failed} / {paper}"


def _share_text(value: dict[Any, Any]) -> str:
    if pd.isna(value["share"]):
        return MISSING
    known = not pd.isna(value["share_low"])
    return f"{value['share']:.0%}" + (f" [{value['share_low']:.0%}, {value['share_high']:.0%}]" if known else "")


def fill(
    table: PaperTable, runs: pd.DataFrame, errors_of: ErrorsOf | None = None, people: pd.DataFrame | None = None
) -> FilledTable:
    """Put runs into a table: mean over seeds, and how far it can be trusted. People fill the rows that ask for them.

    Args:
        table: Of the paper.
        runs: See `read_runs`.
        errors_of: Gives the errors of a run, of which the intervals of shares are made; None for no such intervals.
        people: See `of_people`; None where nobody took the study.
    """
    runs, left_out = _of_one_size(runs, table)
    values, used = [], []
    for choice, paper in zip(_choices(table), chain.from_iterable(table.paper), strict=True):
        if choice.people:
            numbers, found = _people(people, choice.people, choice.metric), runs.iloc[:0]
        else:
            numbers, found = _cell(runs, choice, table.scale)
        used.append(found)
        about = {"row": choice.row, "column": choice.column, "metric": choice.metric}
        values.append({**about, **numbers, "paper": paper})
    frame = pd.DataFrame(values)
    value, low, high = zip(*_shares(table, frame, used, errors_of), strict=True)
    frame = frame.assign(best=_best(table, frame), share=value, share_low=low, share_high=high)
    said = [caption(table, pd.concat(used)), *_controls(table, runs), left_out]
    return FilledTable(table, frame, " ".join(said).strip(), left_out)


def _choices(table: PaperTable) -> list[Choice]:
    """Of every cell, row by row."""
    found = []
    for row, in_row in table.rows.items():
        for column, in_column in table.columns.items():
            names = {"positions": "ground_truth", **table.select, **in_row, **in_column}
            people, metric = names.pop(PEOPLE, ""), names.pop("metric")
            found.append(Choice(row, column, metric, people, names))
    return found


def _of_one_size(runs: pd.DataFrame, table: PaperTable) -> tuple[pd.DataFrame, str]:
    """The runs of each scenario's largest size, and a sentence on the others, which saw other data."""
    if "num_train" not in runs:  # none has a result
        return runs, ""
    found = pd.concat([select(runs, **choice.names) for choice in _choices(table) if not choice.people])
    finished = found[found["error"].isna()].sort_values("num_train")
    largest = finished.groupby("scenario")["size"].last().to_dict()
    is_largest = [largest.get(name, size) == size for name, size in zip(runs["scenario"], runs["size"], strict=True)]
    kept = runs[is_largest]
    if not (others := sorted(set(found["size"]) - set(kept["size"]))):
        return kept, ""
    return kept, f"A table is of one size; runs of another are left out: {', '.join(others)}."


def _controls(table: PaperTable, runs: pd.DataFrame) -> list[str]:
    """A sentence for each control of the table that was run."""
    if not table.controls:
        return []
    nothing: list[list[float | None]] = [[None] * len(table.columns) for _ in table.controls]
    cells = fill(replace(table, rows=table.controls, paper=nothing, controls={}), runs).cells()
    ours = {
        label: row[~row.str.startswith(MISSING)].str.removesuffix(f" / {MISSING}") for label, row in cells.iterrows()
    }
    said = {label: ", ".join(f"{column} {text}" for column, text in row.items()) for label, row in ours.items()}
    return [f"{label}: {numbers}." for label, numbers in said.items() if numbers]


def select(runs: pd.DataFrame, **names: Any) -> pd.DataFrame:
    """The runs of these names."""
    if runs.empty:
        return runs
    chosen = pd.Series(True, index=runs.index)
    for name, value in names.items():
        chosen &= runs[name] == value
    return runs[chosen]


def _cell(runs: pd.DataFrame, choice: Choice, scale: float) -> tuple[dict[str, Any], pd.DataFrame]:
    """The numbers of a cell, and the runs that they are of."""
    found, metric = select(runs, **choice.names), choice.metric
    failed = int(found["error"].notna().sum()) if len(found) else 0
    found = found[found[metric].notna()] if metric in found else found.iloc[:0]
    if found.empty:
        return {**dict.fromkeys(NUMBERS, np.nan), "seeds": 0, "failed": failed}, found
    found = of_seeds(found)
    low, high = found[f"{metric}_low"].mean(), found[f"{metric}_high"].mean()
    numbers = zip(NUMBERS, (found[metric].mean(), found[metric].std(), low, high), strict=True)
    return {**{name: scale * value for name, value in numbers}, "seeds": len(found), "failed": failed}, found


def _people(people: pd.DataFrame | None, setting: str, metric: str) -> dict[str, Any]:
    """The numbers of a cell of people: mean and interval over answers; one study is one seed."""
    if people is None or (found := people[(people[PEOPLE] == setting) & (people["metric"] == metric)]).empty:
        return {**dict.fromkeys(NUMBERS, np.nan), "seeds": 0, "failed": 0}
    (line,) = found.to_dict("records")
    return {**{name: float(line[name]) for name in NUMBERS}, "seeds": 1, "failed": 0}


def _shares(
    table: PaperTable, values: pd.DataFrame, used: list[pd.DataFrame], errors_of: ErrorsOf | None
) -> list[Share]:
    """Of every cell; without errors, or for other metrics than the MSE, of means over the same test experiments."""
    method, other = _axes(table)
    cells = list(zip(values[method], values[other], strict=True))
    runs, means = (dict(zip(cells, each, strict=True)) for each in (used, values["ours"]))
    asked_people = [label for label, keys in table.rows.items() if PEOPLE in keys]  # on a part of the test split
    found = []
    for (name, column), row, metric in zip(cells, values["row"], values["metric"], strict=True):
        compared = [(name, column), *((oracle, column) for oracle in table.ends)] if table.oracles else []
        if not compared or row in asked_people or any(runs[cell].empty for cell in compared):
            found.append(UNKNOWN)
        elif errors_of is not None and metric == "mse":
            ours, without, with_ab = (runs[cell] for cell in compared)
            found.append(share_of_gain(ours, without, with_ab, errors_of))
        elif pd.concat([runs[cell] for cell in compared])["num_test"].nunique() > 1:
            found.append(UNKNOWN)
        else:
            mean, mean_without, mean_with = (means[cell] for cell in compared)
            possible = mean_without - mean_with
            found.append(Share((mean_without - mean) / possible if possible else np.nan))
    return found


def _axes(table: PaperTable) -> tuple[str, str]:
    """The axis of the methods, and the other."""
    return ("row", "column") if table.methods == "rows" else ("column", "row")


def _best(table: PaperTable, values: pd.DataFrame) -> "pd.Series[bool]":
    """Which cells are the best of the methods they compete with."""
    if table.methods is None:
        return pd.Series(False, index=values.index)
    method, other = _axes(table)
    comparable = values["ours"].where(~values[method].isin([*table.bounds, *table.oracles]))
    best = comparable.groupby(values[other]).transform("min" if table.lower_is_better else "max")
    return comparable.eq(best) & comparable.notna()
