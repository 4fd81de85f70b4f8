"""One table per paper table: each cell ours, with the paper's number beside it."""

from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import pandas as pd
import yaml

from cophy.report.runs import COUNTS, NAMES

MISSING = "—"


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper, as paper_tables.yaml describes it: rows are splits, columns are models."""

    id: str
    title: str
    scenario: str
    metric: str
    rows: dict[str, str]  # split -> label
    columns: dict[str, dict[str, str]]  # label -> model and ablation
    paper: dict[str, list[float | None]]  # split -> the paper's numbers, in the order of the columns


@dataclass(frozen=True)
class FilledTable:
    """A paper table with our numbers: `cells` to read, `values` to compute with (split and column labels)."""

    table: PaperTable
    cells: pd.DataFrame
    values: pd.DataFrame
    caption: str


def paper_tables() -> list[PaperTable]:
    """All tables of the paper that runs can fill."""
    content = yaml.safe_load((files("cophy.report") / "paper_tables.yaml").read_text())
    return [PaperTable(**table) for table in content["tables"]]


def fill(table: PaperTable, runs: pd.DataFrame) -> FilledTable:
    """Put runs (see `read_runs`) into a table: mean over seeds, ± standard deviation where there are several."""
    cells, values, used = [], [], []
    for split, label in table.rows.items():
        for (column, choice), printed in zip(table.columns.items(), table.paper[split], strict=True):
            found = _select(runs, scenario=table.scenario, split=split, positions="ground_truth", **choice)
            found = found[found["num_train"] == found["num_train"].max()] if len(found) else found  # one size per cell
            used.append(found)
            ours = found[table.metric] if len(found) else pd.Series(dtype=float)
            cells.append({"train → test": label, "column": column, "cell": f"{_show(ours)} / {_paper(printed)}"})
            values.append(
                {
                    "split": split,
                    "column": column,
                    "ours": ours.mean(),
                    "sd": ours.std(),
                    "seeds": len(ours),
                    "paper": printed,
                }
            )
    wide = pd.DataFrame(cells).pivot(index="train → test", columns="column", values="cell")
    wide = wide.loc[list(table.rows.values()), list(table.columns)]
    wide.columns.name = None
    return FilledTable(table, wide, pd.DataFrame(values), _caption(table, pd.concat(used)))


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """Every row that was run: each test metric, mean over seeds, ± standard deviation where there are several."""
    if runs.empty:
        return pd.DataFrame()
    names = ["scenario", "split", "model", "ablation", "positions", "size"]
    metrics = [column for column in runs.columns if column not in (*NAMES, *COUNTS, "epochs")]
    rows = []
    for choice, found in runs.groupby(names):
        where = " ".join(str(name) for name in choice)
        rows.append({"run": where} | {metric.replace("_", " "): _show(found[metric].dropna()) for metric in metrics})
    return pd.DataFrame(rows)


def _select(runs: pd.DataFrame, **names: Any) -> pd.DataFrame:
    if runs.empty:
        return runs
    chosen = pd.Series(True, index=runs.index)
    for name, value in names.items():
        chosen &= runs[name] == value
    return runs[chosen]


def _show(values: "pd.Series[float]") -> str:
    if values.empty:
        return MISSING
    return f"{values.mean():.3f}" if len(values) == 1 else f"{values.mean():.3f} ± {values.std():.3f}"


def _paper(value: float | None) -> str:
    return MISSING if value is None else f"{value:.3f}"


def _caption(table: PaperTable, used: pd.DataFrame) -> str:
    notes = ["Each cell: ours / the paper's. Lower is better."]
    if used.empty:
        return " ".join([*notes, "Nothing was run yet."])
    values = {
        name: sorted(used[name].unique().tolist()) for name in ("size", "num_train", "num_test", "epochs", "seed")
    }
    size, num_train, num_test, epochs, seeds = (", ".join(map(str, chosen)) for chosen in values.values())
    notes.append(f"Size {size}: {num_train} training and {num_test} test experiments; {epochs} epochs; seeds {seeds}.")
    if "gt_confounders" in used["ablation"].to_numpy():
        notes.append(
            "Where the true confounders are given, they include what positions hide: initial velocity, shape and orientation."
        )
    return " ".join(notes)
