"""The runs of results.csv that fill a cell of a table, and how a cell is printed."""

import csv
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any

from cophy.report.paper_tables import TRUE_POSITIONS, methods, paper_tables, published_mse

ROOT = Path(__file__).parents[1]
SCENARIOS = {"blocktower": "Towers", "balls": "Balls", "collision": "Collisions"}
COPIES = ("copy_c", "copy_b")
COMPETING = tuple(  # what sees no more than CoPhyNet
    name for name, method in methods().items() if method.model and method.competes and not method.simulates
)
GIVEN_MORE = tuple(name for name, method in methods().items() if method.model and name not in COMPETING)
OF_ORACLES = r"\+max_experiments-\d+"  # on how many experiments they are asked
CHANGES = ("", OF_ORACLES, r"\+derenderer-.*")  # what a run may change beyond its names, in this order of preference
SIZES = ("small", "paper")
CURVES = {"blocktower": "3to3", "balls": "4to4", "collision": "all"}
CURVE_METHODS = ("in", "in_sup", "cophynet", "alongside")
CURVE_MEASURES = ("mse", "share", "twin_difference_explained")
NAMES = ("scenario", "split", "model", "ablation", "positions", "size")
TEXTS = (*NAMES, "variant", "datasets", "commit", "predictor", "optimizer")
TABLE = ROOT / "docs" / "results" / "results.csv"
Run = dict[str, Any]


@dataclass(frozen=True)
class Cell:
    """Mean over training seeds, mean of the 95 % intervals, their outermost ends, and the standard deviation over seeds."""

    value: float
    low: float | None
    high: float | None
    lowest: float
    highest: float
    deviation: float
    seeds: int

    def number(self, digits: int = 3, scale: float = 1) -> str:
        """Return the value alone."""
        return f"{round(scale * self.value, digits) + 0.0:.{digits}f}"

    def marked(self, digits: int = 3, scale: float = 1) -> str:
        """Return the value with its number of seeds."""
        return f"{self.number(digits, scale)}{superscript(self.seeds)}"

    def short(self, digits: int = 3, scale: float = 1) -> str:
        """Return the value with its number of seeds, and half of its interval."""
        half = "" if self.low is None or self.high is None else f" ±{scale * (self.high - self.low) / 2:.{digits}f}"
        return f"{self.marked(digits, scale)}{half.replace('±0.', '±.')}"

    def full(self, digits: int = 3, scale: float = 1) -> str:
        """Return the value with its interval; an interval without width is left out."""
        if self.low is None or self.high is None or self.low == self.high:
            return self.number(digits, scale)
        low, high = (f"{round(scale * end, digits) + 0.0:.{digits}f}" for end in (self.low, self.high))
        return f"{self.number(digits, scale)} [{low}, {high}]"


class Results:
    """The runs of a table that benchmarks/results/keep_results.py wrote."""

    def __init__(self, table: Path) -> None:
        self.named: dict[tuple[str, ...], list[Run]] = defaultdict(list)
        with table.open(newline="") as lines:
            for line in csv.DictReader(lines):
                run: Run = {name: text if name in TEXTS else float(text or "nan") for name, text in line.items()}
                run["change"] = re.sub(r"\+size-\w+", "", run["variant"])
                self.named[tuple(run[name] for name in NAMES)].append(run)

    def of(
        self, scenario: str, split: str, method: Mapping[str, str] | str, change: str | None = None, **others: str
    ) -> list[Run]:
        """Return the runs of a method on a split, one per training seed; by default of size=small, on true positions.

        Args:
            scenario, split: Names as on the command line.
            method: Its name, or the model and ablation.
            change: Pattern of what the runs change beyond their names; by default the first of `CHANGES` that fits any.
            others: Further names.
        """
        keys = methods()[method].keys() if isinstance(method, str) else dict(method)
        names = {"size": "small", "positions": TRUE_POSITIONS} | others | keys | {"scenario": scenario, "split": split}
        named = self.named.get(tuple(names[name] for name in NAMES), [])
        for pattern in CHANGES if change is None else [change]:
            if runs := [run for run in named if re.fullmatch(pattern, run["change"])]:
                return runs
        return []

    def cpu_minutes(self, scenario: str, split: str, method: str) -> float:
        """Return the median CPU time of a method's trainings on a split, in minutes; 0 if nothing is trained or it is unknown."""
        seconds = [run["training_cpu_seconds"] for run in self.of(scenario, split, method)]
        return median([each for each in seconds if each > 0] or [0]) / 60

    def cell(
        self, measure: str, scenario: str, split: str, method: Mapping[str, str] | str, **others: str
    ) -> Cell | None:
        """Return the cell of the runs of these names (see `of`); None where none has the measure."""
        return cell_of(self.of(scenario, split, method, **others), measure)

    def learning_curves(self) -> list[Run]:
        """Return the points of all learning curves, with few experiments first; where both sizes have one, that of paper."""
        points = []
        for (scenario, split), method in product(CURVES.items(), CURVE_METHODS):
            curve: dict[float, list[Run]] = {}
            for size in SIZES:
                of_size = defaultdict(list)
                for run in self.of(scenario, split, method, r"(\+num_experiments-\d+)?", size=size):
                    of_size[run["num_train"]].append(run)
                curve |= of_size
            for count, runs in sorted(curve.items()):
                cells = {measure: cell_of(runs, measure) for measure in CURVE_MEASURES}
                points.append({"scenario": scenario, "method": method, "num_train": int(count)} | cells)
        return points


def cell_of(runs: list[Run], measure: str) -> Cell | None:
    """Return the cell of runs that differ in their seed alone; None where none has the measure."""
    known = [run for run in runs if run.get(measure, float("nan")) == run.get(measure)]
    if not known:
        return None
    for shared in ("datasets", "max_epochs"):
        if len({run[shared] for run in known}) > 1:
            raise SystemExit(
                f"results.csv: runs of several {shared} cannot be averaged: {[known[0][name] for name in NAMES]}"
            )
    if len({run["seed"] for run in known}) < len(known):
        raise SystemExit(
            f"results.csv: several runs of one seed cannot be averaged: {[known[0][name] for name in NAMES]}"
        )
    values, lows, highs = ([run[measure + end] for run in known] for end in ("", "_low", "_high"))
    low, high = fmean(lows), fmean(highs)
    interval = (low, high) if low == low and high == high else (None, None)
    deviation = stdev(values) if len(values) > 1 else 0.0
    return Cell(fmean(values), *interval, min(lows), max(highs), deviation, len(known))


def columns(scenario: str) -> dict[str, str]:
    """Return the splits of a scenario's table in the paper, with their labels."""
    table = next(table for table in paper_tables() if table.id == scenario)
    return {keys["split"]: label for label, keys in table.rows.items()}


def column_title(scenario: str, split: str) -> str:
    """Return the name of a column of the paper's tables, with its scenario."""
    return f"{SCENARIOS[scenario]} {columns(scenario)[split]}"


def published(scenario: str, split: str, method: str) -> float | None:
    """Return the MSE that the paper prints; None where it prints none."""
    return published_mse(
        {"positions": TRUE_POSITIONS} | methods()[method].keys() | {"scenario": scenario, "split": split}
    )


def title(method: str) -> str:
    """Return a method's name as prose has it."""
    return in_prose(methods()[method].title)


def in_prose(name: str) -> str:
    """Return a name with a small first letter, unless it is an abbreviation."""
    return name if name[:2].isupper() or name.startswith("CoPhyNet") else name[0].lower() + name[1:]


def superscript(number: int) -> str:
    """Return a number above one as a superscript."""
    return "" if number < 2 else str(number).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


def ratio(one: float, two: float) -> str:
    """Return a ratio with at least two digits."""
    return f"{one / two:.2f}" if one >= 0.1 * two else f"{one / two:.3f}"


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table without padding, so that a changed cell changes one line."""
    lines = [list(header), *map(list, rows)]
    texts = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([texts[0], "|" + "---|" * len(lines[0]), *texts[1:]])


COLUMNS = [(scenario, split, label) for scenario in SCENARIOS for split, label in columns(scenario).items()]
