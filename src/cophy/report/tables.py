"""A table of the paper with our numbers: each cell ours, with the paper's beside it.

The tables of the paper that runs can fill, as paper_tables.yaml describes them.
What a filled table says of its cells, and of the runs that they are of.
Shares of the possible gain, and how sure they are: their interval over twin pairs.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml

from cophy.bootstrap import Ratio, interval
from cophy.report.runs import of_seeds
from cophy.training.run import read_predictions


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
    content = yaml.safe_load((files("cophy.report") / "paper_tables.yaml").read_text())
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


TESTED_ON = {  # positions= -> what a caption says of it
    "ground_truth": "Tested on true positions.",
    "derendered": "Trained and tested on positions estimated from pictures.",
    "train_ground_truth_test_derendered": "Tested on positions estimated from pictures.",
}

ORACLES = (
    "Oracles simulate (docs/benchmark/oracles.md). They know what A and C show at t = 0 beyond positions: object type and pose. "
    "A network gets these with model.object_type=true and model.pose=true alone. "
    "What the oracles' draws add to squared errors is estimated and taken out."
)


def caption(table: PaperTable, used: pd.DataFrame) -> str:
    """The caption of a table.

    Args:
        table: Of the paper.
        used: The runs that fill it, see `read_runs`.
    """
    better = "Lower" if table.lower_is_better else "Higher"
    notes = [f"Each cell: ours / the paper's. {better} is better."]
    if used.empty:
        return " ".join([*notes, "Nothing was run yet."])
    num_train, num_test, seeds = (_listed(used[name]) for name in ("num_train", "num_test", "seed"))
    trained = used[used["is_trained"].astype(bool)]  # copies and oracles have epochs, too, that nobody went through
    epochs = "" if trained.empty else f" {_listed(trained['epochs'])} epochs;"
    size = ", ".join(sorted(used["size"].unique()))
    notes.append(" ".join(TESTED_ON[positions] for positions in sorted(used["positions"].unique())))
    notes.append(f"Size {size}: {num_train} training and {num_test} test experiments;{epochs} seeds {seeds}.")
    notes.append(
        "[ ]: 95 % bootstrap interval over the twin pairs of the test split; ±: standard deviation over seeds."
    )
    if "gt_confounders" in used["ablation"].to_numpy():
        notes.append(
            "Where the true confounders are given, they include what positions hide: initial velocity, shape and orientation."
        )
    if table.oracles and used["model"].str.startswith("oracle_").any():
        notes.append(ORACLES)
    if "derenderer" in used and len(names := sorted(used["derenderer"].dropna().unique())):
        notes.append(f"Positions estimated by de-renderer {' and '.join(names)} (hash of its checkpoint).")
    if "predictor" in used and len(before := used[used["predictor"].notna()]):
        named = sorted({f"{run.model} seed {run.seed} ({run.predictor})" for run in before.itertuples()})
        notes.append(f"Not trained here but given as checkpoints (by hash): {', '.join(named)}.")
    return " ".join([*notes, table.note]).strip()


def _listed(counts: "pd.Series[float]") -> str:
    """Each once; they are floats where some run failed and has none."""
    return ", ".join(map(str, sorted(counts.astype(int).unique())))


class Errors(NamedTuple):
    """What a run got wrong.

    Attributes:
        mse: (experiment,) mean squared error, m².
        pair: (experiment,) the twin pair that it is of.
        truth: (experiment,) sum of the true coordinates, metres: other data have others.
    """

    mse: np.ndarray
    pair: np.ndarray
    truth: np.ndarray


ErrorsOf = Callable[[dict[Any, Any]], Errors]  # from a run's line (`read_runs`)


def stored_errors(run: dict[Any, Any]) -> Errors:
    """Those of the predictions that a run left."""
    return _stored_errors(run["directory"], int(run["metric_dims"]))


@lru_cache(maxsize=256)  # an oracle is compared with every run
def _stored_errors(directory: Path, dims: int) -> Errors:
    found = read_predictions(directory)
    error = np.square(found["position"] - found["target"]) - found.get("draw_variance", 0.0)
    squared, present = error[..., :dims].mean(axis=(1, 3), dtype=np.float64), found["presence"]
    truth = found["target"].sum(axis=(1, 2, 3), dtype=np.float64)
    return Errors(np.where(present, squared, 0.0).sum(axis=1) / present.sum(axis=1), found["pair"], truth)


class Share(NamedTuple):
    """Of what AB can add to the best that is possible without it; negative for what is worse than that.

    Attributes:
        value: 1 for the oracle with AB, 0 for that without.
        low: Of its 95 % interval, paired by experiment.
        high: Likewise.
    """

    value: float
    low: float = np.nan
    high: float = np.nan


UNKNOWN = Share(np.nan)


def share_of_gain(ours: pd.DataFrame, without: pd.DataFrame, with_ab: pd.DataFrame, errors_of: ErrorsOf) -> Share:
    """(oracle without AB - ours) / (oracle without AB - oracle with AB), of what all of them were tested on.

    Oracles are asked about the first experiments of a test split. A model's errors on the others do not count here.

    Args:
        ours: Runs of a row, one per seed; their errors are averaged.
        without: Runs of the oracle without AB.
        with_ab: Runs of the oracle with AB.
        errors_of: Gives the errors of a run.

    Returns:
        NaN where the runs were tested on other experiments, or one of the three is missing.
    """
    parts = [[errors_of(run) for run in runs.to_dict("records")] for runs in (ours, without, with_ab)]
    if not all(parts):
        return UNKNOWN
    asked = min(len(each.pair) for part in parts for each in part)
    tested = {(each.pair[:asked].tobytes(), each.truth[:asked].tobytes()) for part in parts for each in part}
    if len(tested) > 1:
        return UNKNOWN
    of_ours, of_without, of_with = (np.mean([each.mse[:asked] for each in part], axis=0) for part in parts)
    gained, possible = of_without - of_ours, of_without - of_with
    return Share(gained.sum() / possible.sum(), *interval(Ratio(gained, possible), parts[0][0].pair[:asked]))


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
