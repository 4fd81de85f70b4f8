"""Tables of all runs: methods with what they change in rows, tested splits in columns, a table for each kind of data.

A cell shows the runs that differ in their seed alone. Runs on different data never share a cell.
"""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from cophy.report.paper_tables import SIMULATED, method_title, methods
from cophy.report.render import FAILED, UNCERTAINTY, Cell, TextTable, interval, number
from cophy.report.runs import MISSING, POSITIONS, comparable_seeds

TABLE = ["scenario", "size", "positions", "data"]  # shared by the runs of a table
METHOD = ["model", "ablation", "variant"]  # shared by the runs of a row
MAX_SETTINGS = (
    3  # of a method; of more, tables show the unchanged one and the best by validation, and a sweep has its own
)


class Measure(NamedTuple):
    """A measure of a method.

    Attributes:
        title: Of its table, with its unit.
        digits: Digits after the point.
        scale: Factor from the score's unit to that of the title.
        lower_is_better: Whether lower is better.
        note: An explanation for the caption.
    """

    title: str
    digits: int
    scale: float = 1.0
    lower_is_better: bool = False
    note: str = ""


MEASURES = {
    "mse": Measure("test MSE (m²)", 3, lower_is_better=True),
    "twin_difference_explained": Measure(
        "explained part of the twins' difference (%)",
        1,
        100.0,
        note="Twins share A, C and the do-operation and differ in their confounders, which only AB shows. Explained: "
        "1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|², with ΔP and ΔD the predicted and the true difference between twins; 0 for any model "
        "without AB, 100 for a perfect one.",
    ),
    "right_twin_chosen": Measure(
        "right twin chosen (%)",
        1,
        100.0,
        note="How often a prediction is nearer to its own D than to its twin's; 50 by chance.",
    ),
}
VALIDATION = "val/mse"  # MSE of the validation split; no test metric has a slash in its name
COUNTS = ("num_train", "num_test", "epochs", "training_seconds")
MORE_INPUTS = ("model.confounders", "model.object_type", "model.pose", "training.confounder_weight")


def method_cells(runs: pd.DataFrame) -> pd.DataFrame:
    """Return one line for each method and tested split of a table.

    Args:
        runs: See `read_runs`; not empty.

    Returns:
        The names of the table and the method; `method`, its printed name; `column`, the heading of the split; changes, and
        those shared by all trainings of the table; seeds and failed, numbers of runs; num_train, num_test, epochs (NaN
        without training), training_seconds; means over seeds `metrics.<name>` of every metric and of VALIDATION, their
        `sd.<name>`, and means of the ends of intervals `low.<name>`, `high.<name>`; competes, whether it sees what the paper's
        model sees; is_selected, whether it is the best by validation of its method's settings.
    """
    lines, cell_of = list[dict[str, Any]](), dict[Any, int]()
    # an MSE of de-renderers is that of positions in single frames
    of_frames = ("single frames, " + runs["data"]).str.removesuffix(", ")
    runs = runs.assign(data=runs["data"].mask(runs["model"].str.startswith("derenderer"), of_frames))
    for _, of_table in runs.groupby(TABLE):
        shared = shared_changes(of_table)
        for (column, *_), of_cell in of_table.groupby([np.array(_columns(of_table)), *METHOD]):
            finished = of_cell[of_cell["error"].isna()]
            seeds = comparable_seeds(finished) if len(finished) else finished
            cell_of |= dict.fromkeys(seeds.index, len(lines))
            lines.append(
                _line(of_cell, seeds, shared) | {"column": str(column), "failed": len(of_cell) - len(finished)}
            )
    cells = pd.DataFrame(lines).join(_means(runs.loc[list(cell_of)], pd.Series(cell_of, dtype=int)))
    settings = cells.groupby([*TABLE, "column", "model", "ablation"])
    selected = {_selected(of_method) for _, of_method in settings}
    return cells.assign(is_selected=cells.index.isin(selected))


def _means(runs: pd.DataFrame, cell: "pd.Series[int]") -> pd.DataFrame:
    """Return means and standard deviations over the runs of each cell."""
    values = runs.rename(columns={"validation_mse": f"metrics.{VALIDATION}"})
    values = (
        values[[name for name in values if name.startswith(("metrics.", "low.", "high."))]].astype(float).groupby(cell)
    )
    deviations = (
        values.std().filter(regex=r"^metrics\.").rename(columns=lambda name: f"sd.{name.removeprefix('metrics.')}")
    )
    return values.mean().join(deviations)


def shared_changes(runs: pd.DataFrame) -> dict[str, str]:
    """Return what all trained runs of several methods change alike, which captions say once."""
    trained = runs[runs["error"].isna() & runs["is_trained"].eq(True)] if "is_trained" in runs else runs.iloc[:0]
    if trained[["model", "ablation"]].drop_duplicates().shape[0] < 2:
        return {}
    return dict(sorted(set.intersection(*map(set, trained["changes"]))))


def _columns(runs: pd.DataFrame) -> list[str]:
    """Return the split of each run, with its datasets where runs of one split have several."""
    ids = [
        " ".join(sorted(names)) if isinstance(names, list) else ""
        for names in runs.get("dataset_ids", [""] * len(runs))
    ]
    used = pd.DataFrame({"split": runs["split"].to_numpy(), "ids": ids})
    several = used[used["ids"] != ""].groupby("split")["ids"].nunique()
    return [
        f"{split_title(split)} (data {names})" if names and several[split] > 1 else split_title(split)
        for split, names in used.itertuples(index=False)
    ]


def split_title(split: str) -> str:
    """Return the printed name of a split: 3→3 unseen for 3to3_unseen."""
    return re.sub(r"(?<=\d)to(?=\d)|_to_", "→", split).replace("_", " ")


def _line(runs: pd.DataFrame, seeds: pd.DataFrame, shared: dict[str, str]) -> dict[str, Any]:
    """Return names and counts of a cell; `seeds` are those of its runs that are averaged."""
    first = runs.iloc[0]
    changes = dict(first["changes"])
    own = {key: value for key, value in changes.items() if shared.get(key) != value}
    line = {name: first[name] for name in (*TABLE, *METHOD, "split", "directory")}
    line |= {"changes": changes, "shared": shared, "method": method_title(first["model"], first["ablation"], own)}
    line |= {"seeds": len(seeds), "competes": False} | dict.fromkeys(COUNTS, np.nan)
    if seeds.empty:
        return line
    line |= {"num_train": seeds["num_train"].max(), "num_test": seeds["num_test"].min()}
    line["training_seconds"] = seeds["training_seconds"].mean()
    line["epochs"] = seeds["epochs"].max() if seeds["is_trained"].any() else np.nan
    line["competes"] = _competes(first["model"], first["ablation"], changes, seeds["inputs"].iloc[0])
    return line


def _competes(model: str, ablation: str, changes: dict[str, str], inputs: list[str]) -> bool:
    """Return whether a method sees positions of AB and C alone and simulates nothing, so that it can be the best."""
    given_more = {(method.model, method.ablation) for method in methods().values() if not method.competes}
    ablations = {name for _, name in given_more} - {"full"}
    is_given_more = (model, ablation) in given_more or ablation in ablations or not {*MORE_INPUTS}.isdisjoint(changes)
    return not (is_given_more or model.startswith(SIMULATED) or inputs)


def _selected(settings: pd.DataFrame) -> Any:
    """Return the index of the setting of a method with the lowest validation MSE; without any, of the unchanged one."""
    validation = settings.get(f"metrics.{VALIDATION}")
    if validation is not None and validation.notna().any():
        return validation.idxmin()
    return settings["variant"].map(len).idxmin()


def table_name(cell: Any) -> str:
    """Return the title of the table that a line of `method_cells` is in, for example "collision, size small, true positions"."""
    data = f", {cell['data']}" if cell["data"] else ""
    return f"{cell['scenario']}, size {cell['size']}, {POSITIONS[cell['positions']]}{data}"


def method_tables(cells: pd.DataFrame) -> Iterator[TextTable]:
    """Yield a table of each measure for each kind of data.

    Args:
        cells: See `method_cells`.
    """
    for keys, of_table in cells.groupby(TABLE):
        for metric in MEASURES:
            column = f"metrics.{metric}"
            if metric == "mse":
                known = of_table
            else:
                known = of_table[of_table[column].notna()] if column in of_table else of_table.iloc[:0]
            if len(known):
                yield _table(known, metric, "-".join(filter(None, map(str, keys))))


def _table(cells: pd.DataFrame, metric: str, name: str) -> TextTable:
    measure = MEASURES[metric]
    count = cells.groupby(["model", "ablation"])["variant"].transform("nunique")
    kept = cells[(count <= MAX_SETTINGS) | cells["is_selected"] | (cells["variant"].map(len) == 0)]
    best = _best(kept, metric, lower_is_better=measure.lower_is_better)
    lines = kept.to_dict("index")
    orders = {index: _order(line) for index, line in lines.items()}
    rows, columns = sorted(set(orders.values())), sorted(kept["column"].unique(), key=natural)
    most = kept.groupby("column")["num_test"].max()
    cells_at = {
        (orders[index], line["column"]): measured_cell(
            line, metric, measure.digits, measure.scale, first=line["num_test"] != most[line["column"]]
        )._replace(best=index in best)
        for index, line in lines.items()
    }
    table = pd.DataFrame(
        {column: [cells_at.get((row, column), Cell(MISSING)) for row in rows] for column in columns},
        index=[row[-1] for row in rows],
        dtype=object,
    )
    sentences = [_description(kept)]
    if best:
        direction = "lowest" if measure.lower_is_better else "highest"
        sentences.append(
            f"Bold: {direction} of the methods that see positions of AB and C alone, each as chosen by validation."
        )
    if len(kept) < len(cells):
        sentences.append("Of the settings of a sweep, the best by validation.")
    head = table_name(cells.iloc[0])
    short = measure.note or " ".join(sentences)
    caption = " ".join(filter(None, [*sentences, f"{UNCERTAINTY}.", measure.note]))
    return TextTable(re.sub(r"[^\w-]+", "_", f"{name}-{metric}"), f"{head}: {measure.title}", table, caption, short)


def _description(cells: pd.DataFrame) -> str:
    """Return what captions say of numbers of experiments, epochs, seeds and shared changes."""
    done = cells[cells["seeds"] > 0]
    if done.empty:
        return "All runs failed."
    counts = [listed(done[name]) for name in ("num_train", "num_test", "seeds")]
    epochs = f" {listed(done['epochs'])} epochs;" if done["epochs"].notna().any() else ""
    shared = {key: value for key, value in done["shared"].iloc[0].items() if not key.endswith("max_epochs")}
    alike = f" All trainings: {', '.join(f'{key}={value}' for key, value in shared.items())}." if shared else ""
    return f"{counts[0]} training and {counts[1]} test experiments;{epochs} training seeds: {counts[2]}.{alike}"


def listed(counts: "pd.Series[float]") -> str:
    """Return numbers as text: the only one, or the least and the greatest."""
    low, high = int(counts.min()), int(counts.max())
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def measured_cell(
    line: dict[Any, Any], metric: str, digits: int = 3, scale: float = 1.0, *, first: bool = False
) -> Cell:
    """Return the cell of a line of `method_cells`; if `first`, it says that only the first test experiments count."""
    failed = f"({line['failed']} failed)" if line["failed"] else ""
    if not line["seeds"] or pd.isna(line.get(f"metrics.{metric}")):
        return Cell(FAILED if line["failed"] else MISSING)
    note = failed or (f"(first {line['num_test']:.0f})" if first else "")
    value, sd, low, high = (line.get(f"{part}.{metric}", np.nan) for part in ("metrics", "sd", "low", "high"))
    varies = line["seeds"] > 1 and (sd > 0 or not pd.isna(line["epochs"]))  # copy baselines have no random seed
    deviation = f"± {number(scale * sd, digits)}" if varies else ""
    return Cell(number(scale * value, digits), deviation, interval(low, high, f".{digits}f", scale), note)


def _best(cells: pd.DataFrame, metric: str, *, lower_is_better: bool) -> set[Any]:
    """Return the index of the best of each column, of several comparable methods: the same data, and all test experiments."""
    best = set()
    for _, column in cells[cells["seeds"] > 0].groupby("column"):
        largest = [column[name] == column[name].max() for name in ("num_train", "num_test")]
        values = column.loc[
            column["competes"] & column["is_selected"] & largest[0] & largest[1], f"metrics.{metric}"
        ].dropna()
        if len(values) > 1:
            best |= {*values.index[values == (values.min() if lower_is_better else values.max())]}
    return best


def _order(line: dict[Any, Any]) -> tuple[Any, ...]:
    """Return the place of a method in tables: those of the paper's tables first, oracles last; then its printed name."""
    key, ranks = (line["model"], line["ablation"]), _ranks()
    group = 2 if line["model"].startswith(SIMULATED) else 0 if key in ranks else 1
    return group, ranks.get(key, 0), *key, natural(line["variant"]), line["method"]


@cache
def _ranks() -> dict[tuple[str | None, str], int]:
    """Return the place of each of the paper's methods."""
    return {(method.model, method.ablation): rank for rank, method in enumerate(methods().values())}


def natural(text: str) -> tuple[tuple[int, float, str], ...]:
    """Return a key that sorts the numbers in a text by their value."""
    parts = re.split(r"((?<![\d.])\d+(?:\.\d+)?(?:e-?\d+)?)", text)
    return tuple((0, float(part), "") if at % 2 else (1, 0.0, part) for at, part in enumerate(parts))
