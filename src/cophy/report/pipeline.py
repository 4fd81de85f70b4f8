"""From outputs/ to tables and figures, ours beside the paper's numbers."""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.report import difficulty, figures, render
from cophy.report.difficulty import mse_by_difficulty
from cophy.report.figures import draw_stability_distribution
from cophy.report.overview import CAPTION, kinds, overviews, twin_tables
from cophy.report.runs import Choices, notice, read_runs, summary
from cophy.report.tables import FilledTable, PaperTable, fill, paper_tables, stored_errors
from cophy.scenario import Scenario
from cophy.study import report
from cophy.study.report import StudyAnswers, draw_studies, read_answers

log = logging.getLogger(__name__)

OVERVIEW = "MSE of the test split, m² (epochs of training, where there was any, × seeds)."
MOST_FAILURES = 5  # that are told; runs.csv has all
SHOWN = ("run", "seeds", "epochs", "training (s)", "mse", "final position error")  # of the summary, in the terminal


def write_report(outputs: Path, directory: Path, choices: Choices, *, has_twins: bool, show_all: bool) -> None:
    """Print what was run and the paper's tables as far as runs fill them; write them whole, and figures.

    Args:
        outputs: Where train.py wrote its runs.
        directory: Where tables and figures go.
        choices: What the names of runs stand for.
        has_twins: Whether the data have twins, margins and balance, as generated ones have.
        show_all: Whether empty tables, captions and a line for each run are printed, too.
    """
    if not outputs.is_dir():
        raise CophyError(f"outputs={outputs}: there is no such folder; train.py writes runs there, study.py answers")
    runs, studies = read_runs(outputs, choices.keys_of), read_answers(outputs, choices)
    if runs.empty and not studies:
        if runs.attrs["unused"]:
            raise CophyError(f"outputs={outputs}: none of the runs there can be reported, the lines above say why")
        raise CophyError(
            f"outputs={outputs}: there are no runs to report; train.py writes them, see python src/train.py --help"
        )
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    tables = overviews(runs)
    for number, (title, table) in enumerate(tables.items(), start=1):
        render.show(f"What was run: {title}", table, OVERVIEW if number == len(tables) else "")
    _show_failures(runs)
    filled = [_filled(table, runs, studies) for table in paper_tables()]
    drawn = _show_tables(filled, show_all=show_all)
    twins = twin_tables(runs)
    _show_twins(runs)
    answered = report.study_tables(studies)
    for title, table in answered.items():
        render.show(title, table, report.CAPTION)
    everything = summary(runs)
    if show_all and len(everything):
        shown = [name for name in SHOWN if name in everything]
        render.show("Everything that was run", everything[shown].set_index("run"))
    _write_tables(directory, filled, _sections(twins, CAPTION) + _sections(answered, report.CAPTION), everything, runs)
    finished = runs[runs["error"].isna()] if len(runs) else runs
    if len(finished):
        scenarios = {str(name): choices.scenario(str(name)) for name in finished["scenario"].unique()}
        drawn |= dict(figures.of_predictions(finished, scenarios))
        if has_twins:
            drawn |= _stability_distributions(finished, scenarios, choices)
            drawn |= _write_difficulty(directory, finished, scenarios, choices)
    drawn |= dict(draw_studies(studies))
    for name, figure in drawn.items():
        figures.write_figure(directory / "figures", name, figure)
    skipped = runs.attrs["skipped"]
    not_read = f" ({skipped} more cannot be read, see above)" if skipped else ""
    said = "%d runs%s; tables (md, tex, csv), their captions and %d figures (png, pdf) in\n%s"
    log.info(said, len(runs), not_read, len(drawn), directory)


def _filled(table: PaperTable, runs: pd.DataFrame, studies: list[StudyAnswers]) -> FilledTable:
    """A table of the paper, with the people of the studies where it has rows of people."""
    names = table.select
    people = report.of_people(studies, names["scenario"], names["split"]) if "split" in names else None
    return fill(table, runs, stored_errors, people)


def _show_failures(runs: pd.DataFrame) -> None:
    """Print why runs failed."""
    failed = runs[runs["error"].notna()].to_dict("records") if len(runs) else []
    for run in failed[:MOST_FAILURES]:
        log.info(notice(f"failed: {run['directory']}: {run['error']}"))
    if failed:
        log.info(notice("A failed run is forgotten once it is made again, or its folder is removed."))


def _show_tables(filled: list[FilledTable], *, show_all: bool) -> dict[str, Figure]:
    """Print what is filled, or all; what is filled as bars."""
    drawn, empty = {}, 0
    for result in filled:
        is_filled = result.has_runs
        empty += not is_filled
        cells = result.cells(bold=render.BOLD)
        if show_all:
            render.show(result.table.title, cells, result.caption)
        elif is_filled:
            better = "Lower" if result.table.lower_is_better else "Higher"
            caption = f"Ours, the paper's below it. {better} is better. {result.left_out}".strip()
            render.show(result.table.title, render.filled_only(cells), caption)
        if not is_filled:
            continue
        if (shares := result.shares()) is not None:
            shown = shares if show_all else render.filled_only(shares)
            render.show(render.SHARE, shown)
        if result.values["seeds"].any():
            drawn[f"table-{result.table.id}"] = figures.draw_bars(result)
    if empty and not show_all:
        log.info(notice(f"{empty} tables have nothing of ours yet: all=true shows them."))
    return drawn


def _write_tables(
    directory: Path,
    filled: list[FilledTable],
    sections: str,
    everything: pd.DataFrame,
    runs: pd.DataFrame,
) -> None:
    """Tables as Markdown, LaTeX and CSV, and a summary of everything that was run.

    Args:
        directory: Where they go.
        filled: The paper's tables; those with something of ours come first.
        sections: What follows the paper's tables, Markdown.
        everything: That summary.
        runs: See `read_runs`.
    """
    filled = sorted(filled, key=lambda table: not table.has_runs)
    written = {
        "tables.md": "\n".join(map(render.markdown, filled))
        + sections
        + f"\n## Everything that was run\n\n{everything.to_markdown(index=False)}\n",
        "tables.tex": "\n".join(map(render.latex, filled)),
        "runs.csv": runs.to_csv(index=False),
        **{f"{result.table.id}.csv": result.values.to_csv(index=False) for result in filled},
    }
    for name, text in written.items():
        write_atomically(directory / name, text.encode())


def _show_twins(runs: pd.DataFrame) -> None:
    """Print what predictions tell of twins, for each kind of runs apart."""
    shown = [(f"{title}: {kind}", table) for kind, found in kinds(runs) for title, table in twin_tables(found).items()]
    for title, table in shown:
        short = table.columns.str.replace(r"^\S+ (\S+), [^,]*(, \d+ epochs)?.*", r"\1\2", regex=True)
        alone = short.str.replace(r", .*", "", regex=True)  # the epochs of each are told above
        splits = table.set_axis(alone if alone.is_unique else short, axis=1)
        render.show(title, splits)
    if shown:
        log.info(notice(CAPTION))


def _sections(tables: Mapping[str, pd.DataFrame], caption: str) -> str:
    """Tables by their titles as sections of Markdown."""
    sections = [f"\n## {title}\n\n{table.to_markdown()}\n" for title, table in tables.items()]
    return "".join([*sections, f"\n{caption}\n"]) if sections else ""


def _write_difficulty(
    directory: Path, runs: pd.DataFrame, scenarios: Mapping[str, Scenario], choices: Choices
) -> dict[str, Figure]:
    """MSE by difficulty on the default split of each scenario, where its dataset is there."""
    default = {name: scenario.task.splits[0] for name, scenario in scenarios.items()}
    predictors = runs[(runs["split"] == runs["scenario"].map(default)) & ~runs["model"].str.startswith("derenderer")]
    frames = []
    for keys, found in predictors.groupby(["scenario", "split", "size"]):
        name, split, size = (str(key) for key in keys)
        part = choices.split(name, split).test
        states = choices.dataset(name, part.num_objects, size)
        if (arrays := _load(states)) is not None:
            frames.append(mse_by_difficulty(found, arrays, states.spec, part))
    lines = pd.concat(frames) if frames else pd.DataFrame()
    if lines.empty:
        return {}
    write_atomically(directory / "difficulty.csv", lines.to_csv(index=False).encode())
    write_atomically(directory / "difficulty.md", difficulty.page(lines, scenarios).encode())
    return dict(difficulty.draw(lines, scenarios))


def _stability_distributions(
    runs: pd.DataFrame, scenarios: Mapping[str, Scenario], choices: Choices
) -> dict[str, Figure]:
    """The figure of that name, from the tower datasets that the runs used, where they are there."""
    towers = runs[[scenarios[name].statics is not None for name in runs["scenario"]]]
    drawn = {}
    for keys, found in towers.groupby(["scenario", "size"]):
        name, size = (str(key) for key in keys)
        used, arrays = set(found["dataset_ids"].explode()), {}
        for count in scenarios[name].num_objects:
            states = choices.dataset(name, count, size)
            if states.id in used and (loaded := _load(states)) is not None:
                arrays[count] = loaded
        if arrays:
            drawn[f"stability_distribution-{size}"] = draw_stability_distribution(arrays)
    return drawn


def _load(states: States) -> dict[str, np.ndarray] | None:
    """The arrays of a dataset; where it is not there, the log says so."""
    if states.is_finished():
        return states.load()
    log.info(notice(f"{states.directory} is not there: the report does without what only the dataset tells."))
    return None
