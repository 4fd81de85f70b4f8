"""One table per paper table: each cell ours, with the paper's number beside it."""

from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import pandas as pd
import yaml

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
    sizes = ", ".join(sorted(used["size"].unique()))
    counts = [
        f"{used[name].min()}–{used[name].max()}" if used[name].nunique() > 1 else f"{used[name].iloc[0]}"
        for name in ("num_train", "num_test")
    ]
    notes.append(
        f"Size {sizes}: {counts[0]} training and {counts[1]} test experiments; seeds {sorted(used['seed'].unique().tolist())}."
    )
    if any("gt_confounders" in choice.values() for choice in table.columns.values()):
        notes.append("True confounders include the initial velocities.")
    return " ".join(notes)
