"""Paired comparisons of methods with intervals, tests and a win/tie/loss table: report.py compare=[alongside,cophynet]"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import false_discovery_control
from scipy.stats import t as student_t

from cophy.atomic_files import write_atomically
from cophy.bootstrap import MIN_CLUSTERS, mean, variance_of_mean
from cophy.errors import CophyError
from cophy.report import render
from cophy.report.methods import MEASURES, split_title
from cophy.report.paper_tables import TRUE_POSITIONS, method_title, methods
from cophy.report.predictions import stored_scores
from cophy.report.runs import IN_CAPTIONS, MISSING, POSITIONS, comparable_seeds, elsewhere, notice, read_runs
from cophy.scoring import Scores, average, compare, have_same_experiments

log = logging.getLogger(__name__)

FILES = "comparisons"
COLUMN = ("scenario", "split", "size", "data")  # runs that agree in these were tested on the same experiments
DATA_SEED = "data_seed-"
COLUMNS_OF_TEST = ("difference", "p")
NEGLIGIBLE = 1e-9  # in the unit of tables: rounding errors
SIGNIFICANT = 0.05  # false discovery rate
COMPARED = ("mse", "twin_difference_explained")  # of MEASURES
CAPTION = (
    "Difference: first - second, paired by experiment, mean over seeds, with its 95 % t interval over clusters of test "
    "experiments and, for methods with several seeds, over training seeds; intervals are not corrected for the number of "
    "tests. ±: standard deviation over seeds. p: two-sided t test, corrected for all tests of the measure "
    "(Benjamini-Hochberg). *: significantly different, p < 0.05 (false discovery rate)."
)
COUNTS_CAPTION = (
    "Columns in which the row's method is significantly better than the column's / not significantly different / "
    "significantly worse."
)


class Difference(NamedTuple):
    """Difference between two methods with its 95 % interval and the p-value of a two-sided test; NaN where unknown."""

    value: float
    low: float
    high: float
    p: float


def difference(ours: Sequence[Scores], others: Sequence[Scores], measure: str) -> Difference:
    """Compare two methods, experiment by experiment.

    The variance of the difference of means has a part from the choice of test experiments, estimated over clusters from the
    paired differences of the seeds' means, and, for each method with several seeds, a part from the choice of training seeds:
    their variance divided by their number. Interval and test are Student's t with Welch-Satterthwaite degrees of freedom, so
    they agree with each other. Seeds are not paired: the same seed means different weights in different networks. What both
    choices share (noise of training that differs from experiment to experiment) counts twice, so the interval is rather
    too wide. With one seed per method, it is a statement about two trainings.

    Args:
        ours: Scores of one method, one per seed.
        others: Scores of another method on the same experiments.
        measure: Name of a measure that all of them have.

    Raises:
        CophyError: The scores are not of the same experiments in the same order.
    """
    paired = compare(average(ours), average(others))
    parts = [variance_of_mean(paired.values[measure], paired.cluster)]
    for seeds in (ours, others):
        if len(seeds) > 1:
            means = [mean(scores.values[measure]) for scores in seeds]
            parts.append((np.var(means, ddof=1) / len(means), len(means) - 1))
    value, variance = mean(paired.values[measure]), sum(part for part, _ in parts)
    if parts[0][1] < MIN_CLUSTERS - 1:
        return Difference(value, np.nan, np.nan, np.nan)
    if not variance:  # the same difference in every experiment
        return Difference(value, value, value, float(value == 0))
    freedom, error = variance**2 / sum(part**2 / degrees for part, degrees in parts), np.sqrt(variance)
    half = student_t.ppf(0.975, freedom) * error
    return Difference(value, value - half, value + half, float(2 * student_t.sf(abs(value) / error, freedom)))


def compare_methods(outputs: Path, names: Sequence[str]) -> pd.DataFrame:
    """Compare every two of these methods on every split that both were tested on.

    Args:
        names: Methods by name, for example cophynet, in_sup, cophynet+hidden_dim-8 or cophynet@derendered: a model or a row,
            what its runs change as their directories have it, and positions other than the true ones.

    Returns:
        One line per pair, column and measure, in the order of the names: what was tested, the titles of both methods, their
        seeds, epochs, means and standard deviations over seeds, the difference with its interval and p, in the measure's own
        unit; p_adjusted; and outcome: 1 where the first method is significantly better, -1 where the other is, else 0.

    Raises:
        CophyError: A method has no runs, or nothing can be compared.
    """
    runs = _read_runs(outputs)
    by_name = {name: _runs_of(runs, name) for name in names}
    if missing := [name for name, its_runs in by_name.items() if its_runs.empty]:
        known = ", ".join(sorted(set(runs["name"])))
        raise CophyError(f"compare=: {outputs} has no run of {', '.join(missing)}; there are {known}")
    chosen = {_title(name, its_runs): its_runs for name, its_runs in by_name.items()}
    if len(chosen) < 2:
        raise CophyError(f"compare=[{','.join(names)}]: name two or more methods, such as compare=[cophynet,in]")
    columns = pd.concat(chosen.values())[list(COLUMN)].drop_duplicates().sort_values(list(COLUMN))
    lines: list[dict[str, Any]] = []
    for column in columns.to_dict("records"):
        tested = {title: _seeds(its_runs, column) for title, its_runs in chosen.items()}
        lines += _compare_pairs({title: seeds for title, seeds in tested.items() if seeds}, column)
    if not lines:
        raise CophyError(f"compare=: no two of {', '.join(names)} were tested on the same experiments of {outputs}")
    frame = pd.DataFrame(lines)
    frame["p_adjusted"] = frame.groupby("measure")["p"].transform(_adjusted)
    signs = {name: -1 if MEASURES[name].lower_is_better else 1 for name in COMPARED}
    better = np.sign(frame["measure"].map(signs) * frame["difference"])
    frame["outcome"] = better.where(frame["p_adjusted"] < SIGNIFICANT, 0).astype(int)
    return frame


def _read_runs(outputs: Path) -> pd.DataFrame:
    """Return the finished predictors (see `read_runs`) with their names; `changes` are the parts of their variant."""
    runs = read_runs(outputs)
    runs = runs if runs.empty else runs[runs["error"].isna() & ~runs["model"].str.startswith("derenderer")]
    if runs.empty:
        raise CophyError(f"outputs={outputs}: {elsewhere(runs) or 'there are no finished predictors to compare'}")
    runs = runs.assign(changes=runs["variant"].str.split("+").str[1:])
    return runs.assign(name=runs.apply(_name, axis=1))


def _name(run: "pd.Series[Any]") -> str:
    """Return the name of a run's method: what captions or columns name is no part of it."""
    kept = [change for change in run["changes"] if not change.startswith((*IN_CAPTIONS, DATA_SEED))]
    positions = "" if run["positions"] == TRUE_POSITIONS else f"@{run['positions']}"
    return "+".join([_base(run["model"], run["ablation"]), *kept]) + positions


def _base(model: str, ablation: str) -> str:
    return model if ablation == "full" else f"{model}_{ablation}"


def _parts(name: str) -> tuple[str, list[str], str]:
    """Return base, changes and positions of a method's name."""
    text, _, positions = name.partition("@")
    base, *changes = text.split("+")
    if (row := methods().get(base)) and row.model:
        base = _base(row.model, row.ablation)
    return base, changes, positions or TRUE_POSITIONS


def _title(name: str, runs: pd.DataFrame) -> str:
    """Return the printed name of a method that has these runs."""
    _, changes, positions = _parts(name)
    notes = [*changes, *([] if positions == TRUE_POSITIONS else [POSITIONS[positions]])]
    title = method_title(runs["model"].iloc[0], runs["ablation"].iloc[0])
    return f"{title} ({', '.join(notes)})" if notes else title


def _runs_of(runs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the runs of a method: what they change beyond its name may be in captions only."""
    base, changes, positions = _parts(name)

    def matches(run: "pd.Series[Any]") -> bool:
        others = set(run["changes"]) - set(changes)
        return (
            (_base(run["model"], run["ablation"]), run["positions"]) == (base, positions)
            and set(changes) <= set(run["changes"])
            and all(change.startswith((*IN_CAPTIONS, DATA_SEED)) for change in others)
        )

    return runs[runs.apply(matches, axis=1)]


class Tested(NamedTuple):
    """The seeds of a method in one column."""

    scores: list[Scores]
    epochs: str


def _seeds(runs: pd.DataFrame, column: Mapping[Any, Any]) -> Tested | None:
    """Return the scores of the comparable seeds of a method in a column; the log names those that are left out."""
    runs = runs[(runs[list(COLUMN)] == pd.Series(column)).all(axis=1)]
    if runs.empty:
        return None
    scores, runs = [], comparable_seeds(runs)
    for run in runs.to_dict("records"):
        try:
            scores.append(stored_scores(run))
        except (CophyError, OSError) as error:
            log.warning("%s is skipped: %s", run["directory"], error)
    if scores and not have_same_experiments(scores):
        log.warning(notice(f"{runs['directory'].iloc[0]}: its seeds were tested on different data: not compared"))
        return None
    trained = runs[runs["is_trained"].astype(bool)]
    return Tested(scores, ", ".join(map(str, sorted(trained["epochs"].astype(int).unique())))) if scores else None


def _compare_pairs(tested: Mapping[str, Tested], column: Mapping[Any, Any]) -> Iterator[dict[str, Any]]:
    for (one, ours), (other, others) in combinations(tested.items(), 2):
        if not have_same_experiments([ours.scores[0], others.scores[0]]):
            place = ", ".join(filter(None, map(str, column.values())))
            reason = "were tested on different experiments or data: not compared"
            log.warning(notice(f"{place}: {one} and {other} {reason}"))
            continue
        for measure in COMPARED:
            means = [
                [mean(each.values[measure]) for each in method.scores if measure in each.values]
                for method in (ours, others)
            ]
            if not all(means):  # released data have no twins
                continue
            numbers = difference(ours.scores, others.scores, measure)._asdict()
            yield {
                **column,
                "measure": measure,
                **{"method": one, "seeds": len(means[0]), "epochs": ours.epochs},
                **{"mean": np.mean(means[0]), "sd": _deviation(means[0])},
                **{"other": other, "other_seeds": len(means[1]), "other_epochs": others.epochs},
                **{"other_mean": np.mean(means[1]), "other_sd": _deviation(means[1])},
                "experiments": len(ours.scores[0].experiment),
                "clusters": len(np.unique(ours.scores[0].cluster)),
                "difference": numbers.pop("value"),
                **numbers,
            }


def _deviation(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else np.nan


def _adjusted(p: "pd.Series[float]") -> "pd.Series[float]":
    """Return p-values corrected by Benjamini and Hochberg for all that are known."""
    known = p.dropna()
    return pd.Series(false_discovery_control(known), known.index).reindex(p.index) if len(known) else p


def comparison_tables(frame: pd.DataFrame) -> Iterator[render.TextTable]:
    """Yield a table of each pair of methods and measure."""
    for (measure, one, other), lines in frame.groupby(["measure", "method", "other"], sort=False):
        rows = {_label(line, frame): _cells(line) for line in lines.to_dict("records")}
        cells, title = _wide(rows, [str(one), str(other), *COLUMNS_OF_TEST]), MEASURES[str(measure)].title
        yield render.TextTable(f"{FILES}-{measure}", f"{one} vs {other}: {title}", cells, _amounts(lines))


def latex_tables(frame: pd.DataFrame) -> Iterator[render.TextTable]:
    """Yield a table of all pairs for each measure; ± and intervals are below the numbers."""
    for number, (measure, lines) in enumerate(frame.groupby("measure", sort=False)):
        by_names = {
            (f"{line['method']} vs {line['other']}", _label(line, frame)): _cells(line)
            for line in lines.to_dict("records")
        }
        alike = [len(set(names)) == 1 for names in zip(*by_names, strict=True)]  # such names are in the title
        if all(alike):
            alike = [False, True]
        rows = {
            ": ".join(name for name, is_alike in zip(names, alike, strict=True) if not is_alike): cells
            for names, cells in by_names.items()
        }
        of_all = [name for name, is_alike in zip(next(iter(by_names)), alike, strict=True) if is_alike]
        table = _wide(rows, ["first", "second", *COLUMNS_OF_TEST]).map(
            lambda cell: render.Cell(cell.ours, interval=cell.deviation or cell.interval)
        )
        columns = "Columns, intervals and p are those of the first table of comparisons." if number else CAPTION
        title = ": ".join(["Comparisons", *of_all, MEASURES[str(measure)].title])
        yield render.TextTable(f"{FILES}-{measure}", title, table, f"{columns} {_amounts(lines)}")


def _wide(rows: Mapping[str, Sequence[render.Cell]], columns: Sequence[str]) -> pd.DataFrame:
    cells = {column: [row[n] for row in rows.values()] for n, column in enumerate(columns)}
    return pd.DataFrame(cells, index=[*rows], dtype=object)


def _cells(line: Mapping[Any, Any]) -> tuple[render.Cell, ...]:
    """Return the cells of a comparison: both methods and COLUMNS_OF_TEST."""
    measure = MEASURES[line["measure"]]
    scale, digits = measure.scale, measure.digits

    def method(prefix: str) -> render.Cell:
        value, sd = (scale * line[f"{prefix}{name}"] for name in ("mean", "sd"))
        varies = sd > 0 or (line[f"{prefix}epochs"] and not np.isnan(sd))  # copy baselines have no random seed
        deviation = f"± {render.number(sd, digits)}" if varies else ""
        return render.Cell(render.number(value, digits), deviation)

    value, low, high = (scale * line[name] for name in ("difference", "low", "high"))
    interval = f"[{_signed(low, digits)}, {_signed(high, digits)}]" if low < high else ""
    p, is_known = line["p_adjusted"], not np.isnan(line["p"])
    return (
        *map(method, ("", "other_")),
        render.Cell(f"{_signed(value, digits, '+')}{'*' if line['outcome'] else ''}", interval=interval),
        render.Cell((f"{p:.3f}" if p >= 0.001 else "< 0.001") if is_known else "too few"),
    )


def _signed(value: float, digits: int, sign: str = "") -> str:
    """Return a number as text; with more digits if rounding would hide that it is not 0."""
    while round(value, digits) == 0 and abs(value) > NEGLIGIBLE:
        digits += 1
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"  # no -0.000


def _label(line: Mapping[Any, Any], frame: pd.DataFrame) -> str:
    """Return the name of a column; the size is in captions where there is one."""
    place = [line["scenario"], split_title(line["split"])]
    size = [line["size"]] if frame["size"].nunique() > 1 else []
    return " ".join(filter(None, [*place, *size, line["data"].replace("_seed=", " seed ")]))


def _amounts(lines: pd.DataFrame) -> str:
    """Return what a table was measured on, and what limits it."""
    counts = {
        "Size": lines["size"],
        "test experiments": lines["experiments"],
        "clusters": lines["clusters"],
        "seeds": lines["seeds"].astype(str) + " vs " + lines["other_seeds"].astype(str),
        "epochs": lines["epochs"].replace("", "no") + " vs " + lines["other_epochs"].replace("", "no"),
    }
    text = "; ".join(f"{name}: {', '.join(map(str, values.unique()))}" for name, values in counts.items())
    too_few = sorted(lines["clusters"][lines["p"].isna()].unique())
    needed = f"intervals and tests need {MIN_CLUSTERS} or more."
    few = f" Too few clusters of test experiments: {', '.join(map(str, too_few))}; {needed}" if too_few else ""
    trained = [lines[f"{prefix}epochs"].ne("") & lines[f"{prefix}seeds"].eq(1) for prefix in ("", "other_")]
    single = " With one seed, single trainings are compared, not methods." if np.any(trained) else ""
    return f"{text}.{few}{single}"


def count_tables(frame: pd.DataFrame) -> Iterator[render.TextTable]:
    """Yield method × method of wins/ties/losses over columns, of each measure."""
    for number, (measure, all_lines) in enumerate(frame.groupby("measure", sort=False)):
        lines = all_lines[all_lines["p"].notna()]
        titles = list(dict.fromkeys([*all_lines["method"], *all_lines["other"]]))
        table = pd.DataFrame(MISSING, index=titles, columns=titles)
        for (one, other), outcomes in lines.groupby(["method", "other"])["outcome"]:
            wins, ties, losses = (int((outcomes == outcome).sum()) for outcome in (1, 0, -1))
            table.loc[one, other] = f"{wins} / {ties} / {losses}"
            table.loc[other, one] = f"{losses} / {ties} / {wins}"
        if len(lines):
            columns = dict.fromkeys(_label(line, frame) for line in lines.to_dict("records"))
            title = f"Wins / ties / losses: {MEASURES[str(measure)].title}"
            caption = f"{COUNTS_CAPTION} Columns: {', '.join(columns)}."
            yield render.TextTable(f"{FILES}-wins-{number}", title, table.map(render.Cell), caption)


def write_comparisons(outputs: Path, directory: Path, names: Sequence[str]) -> None:
    """Print comparisons of methods (see `compare_methods`) and write them as Markdown, CSV and LaTeX.

    Of more than two methods, the terminal has the pairs with the first.
    """
    if not outputs.is_dir():
        raise CophyError(f"outputs={outputs}: there is no such folder; train.py writes runs there")
    frame = compare_methods(outputs, names)
    counts, tables = list(count_tables(frame)), list(comparison_tables(frame))
    latex = [render.latex(table, keep_intervals=True) for table in latex_tables(frame)]
    texts = {
        "md": "\n".join([*map(render.markdown, [*counts, *tables]), CAPTION, ""]),
        "csv": frame.to_csv(index=False),
        "tex": "\n".join([render.LATEX_HEAD, *latex, *map(render.latex, counts)]),
    }
    directory.mkdir(parents=True, exist_ok=True)
    for kind, text in texts.items():
        write_atomically(directory / f"{FILES}.{kind}", text.encode())
    for table in tables:
        if table.title.startswith(f"{frame['method'].iloc[0]} vs "):
            render.show(table.title, table.cells.map(_stacked), table.caption)
    log.info(f"{notice(CAPTION)}\n")
    for table in counts:
        render.show(table.title, table.cells, table.caption)
    log.info(f"All pairs are in\n{directory / FILES}.md, .csv and .tex")


def _stacked(cell: render.Cell) -> render.Cell:
    """Return a cell of the terminal, with what is not its number below that."""
    return render.Cell("\n".join(filter(None, (cell.ours, cell.deviation, cell.interval))))
