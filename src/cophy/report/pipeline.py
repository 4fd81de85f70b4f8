"""From outputs/ to tables and figures, ours next to the paper's numbers."""

import logging
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.drawing.plots import write_figure
from cophy.errors import CophyError
from cophy.report import difficulty, figures, render
from cophy.report.methods import method_cells, method_tables
from cophy.report.paper_tables import paper_tables
from cophy.report.predictions import StoredPredictions, read_stored_predictions
from cophy.report.runs import DatasetIds, elsewhere, filter_runs, notice, read_runs, standard_runs
from cophy.report.sweeps import draw_sweep, find_sweeps, sweep_table
from cophy.report.tables import fill
from cophy.scenario import Scenario
from cophy.scoring import Scores
from cophy.workers import worker_pool

log = logging.getLogger(__name__)

NUM_PROCESSES, MANY_FIGURES = 2, 16  # figures take most of the time of a report; from so many on, processes write them
FIGURE = re.compile(
    r"(table|trajectories|error_over_time|sweep|stability_distribution|difficulty|study)-."
)  # names of figures
MAX_FAILURES = 5  # printed; runs.csv has all


@dataclass(frozen=True)
class Configurations:
    """What the names of runs stand for.

    Attributes:
        scenario: Returns the scenario of a name.
        default_split: Returns the default split of the scenario of a name.
        dataset: Returns a generated dataset, by name of the scenario, number of objects and name of the size; None where
            the runs are on other data, which have no twins, margins or balance.
        dataset_ids: See `standard_runs`.
    """

    scenario: Callable[[str], Scenario]
    default_split: Callable[[str], Split]
    dataset: Callable[[str, int, str], States] | None
    dataset_ids: DatasetIds


@dataclass(frozen=True)
class Supplement:
    """What an optional subpackage adds to the report.

    Attributes:
        participants: Numbers of human participants for the paper's tables: scenario, split, setting, metric, ours, sd, low,
            high.
        tables: Its own tables.
        figures: By name.
    """

    participants: pd.DataFrame | None = None
    tables: list[render.TextTable] = field(default_factory=list)
    figures: dict[str, Figure] = field(default_factory=dict)


class Report:
    """Tables and figures of the runs in a folder.

    Args:
        configurations: What the names of runs stand for.
        supplement: Results of human participants.
        models, splits: See `filter_runs`.
        paper: Whether it shows the paper's tables; None for those that runs fill, as far as they do.

    Raises:
        CophyError: There is nothing to report.
    """

    def __init__(
        self,
        outputs: Path,
        configurations: Configurations,
        supplement: Supplement,
        models: Sequence[str],
        splits: Sequence[str],
        paper: bool | None,
    ) -> None:
        runs = read_runs(outputs)
        self.configurations, self.supplement, self.models, self.paper = configurations, supplement, models, paper
        self.unused, self.stored = int(runs.attrs["unused"]), dict[Path, StoredPredictions]()
        if len(runs):
            runs = filter_runs(runs, models, splits)
            predictors = runs[runs["error"].isna() & ~runs["model"].str.startswith("derenderer")]
            self.stored = read_stored_predictions(predictors)
            self.unused += len(predictors) - len(self.stored)
            runs = runs[~runs["directory"].isin(set(predictors["directory"]) - set(self.stored))]
        if runs.empty and not supplement.tables:
            if self.unused:
                raise CophyError(f"outputs={outputs}: no run can be reported, for the reasons above")
            remedy = elsewhere(runs) or "there are no runs; train.py writes them (python src/train.py --help)"
            raise CophyError(f"outputs={outputs}: {remedy}")
        self.runs = runs if len(runs) else pd.DataFrame()
        self.cells = method_cells(runs) if len(runs) else pd.DataFrame()
        self.tables = list(method_tables(self.cells)) if len(runs) else []
        self.sweeps = list(find_sweeps(self.cells)) if len(runs) else []
        standard = standard_runs(runs, configurations.dataset_ids) if len(runs) else self.runs
        self.finished = standard[standard["error"].isna()] if len(standard) else pd.DataFrame()
        names = self.finished["scenario"].unique() if len(self.finished) else ()
        self.scenarios = {str(name): configurations.scenario(str(name)) for name in names}
        scores = {directory: predictions.scores for directory, predictions in self.stored.items()}
        self.difficulty = self._mse_by_difficulty(scores)
        tables = paper_tables() if paper is not False else ()
        filled = [fill(table, standard, scores, supplement.participants) for table in tables]
        self.filled = [table for table in filled if table.has_runs or paper]

    def show(self) -> None:
        """Print the tables of all runs, their sweeps, and the paper's tables."""
        printed = set[str]()
        for table in self.tables:
            render.show(table.title, table.cells, "" if table.note in printed else table.note)
            printed.add(table.note)
        self._show_failures()
        for table in map(sweep_table, self.sweeps):
            render.show(table.title, table.cells, table.note)
        for filled in self.filled:
            table, *shares = render.paper_text_tables(filled, whole=bool(self.paper))
            better = "Lower" if filled.table.lower_is_better else "Higher"
            render.show(
                table.title, table.cells, f"Ours, the paper's below it. {better} is better. {filled.left_out}".strip()
            )
            for share in shares:
                render.show(share.title, share.cells)
        for table in self.supplement.tables:
            render.show(table.title, table.cells, table.caption)

    def _show_failures(self) -> None:
        failed = self.runs[self.runs["error"].notna()].to_dict("records") if len(self.runs) else []
        for run in failed[:MAX_FAILURES]:
            log.info(notice(f"failed: {run['directory']}: {run['error']}"))
        if failed:
            log.info(notice("Run the same command again, or remove the folder of a failed run to forget it."))

    def write_tables(self, directory: Path) -> set[str]:
        """Write all tables as Markdown, LaTeX and CSV; return the names of their files."""
        texts = self._texts()
        if len(self.difficulty):
            texts["difficulty.csv"] = self.difficulty.to_csv(index=False)
            texts["difficulty.md"] = difficulty.page(self.difficulty, self.scenarios)
        for name, text in texts.items():
            write_atomically(directory / name, text.encode())
        return {*texts}

    def _texts(self) -> dict[str, str]:
        """Return the content of the files of tables by name."""
        papers = [render.paper_text_tables(filled, whole=bool(self.paper)) for filled in self.filled]
        tables = [*self.tables, *map(sweep_table, self.sweeps), *chain.from_iterable(papers)]
        # without failed settings, and so without keys that only these change
        sweeps = find_sweeps(self.cells[self.cells["seeds"] > 0]) if len(self.cells) else ()
        of_latex = [*self.tables, *map(sweep_table, sweeps), *chain.from_iterable(papers)]
        return {
            "tables.md": "\n".join(map(render.markdown, [*tables, *self.supplement.tables])),
            "tables.tex": "\n".join([render.LATEX_HEAD, *filter(None, map(render.latex, of_latex))]),
            "document.tex": render.LATEX_DOCUMENT,
            "runs.csv": self._as_csv(self.runs),
            "methods.csv": self._as_csv(self.cells),
            **{
                f"{filled.table.id}.csv": filled.lines(whole=bool(self.paper)).to_csv(index=False)
                for filled in self.filled
            },
        }

    @staticmethod
    def _as_csv(lines: pd.DataFrame) -> str:
        """Return lines as CSV, with changed keys as text: model.hidden_dim=8 training.learning_rate=0.001."""
        for name in {"changes", "shared"}.intersection(lines):
            texts = [" ".join(f"{key}={value}" for key, value in dict(changes).items()) for changes in lines[name]]
            lines = lines.assign(**{name: texts})
        return lines.to_csv(index=False)

    def figures(self) -> Iterator[tuple[str, Figure]]:
        """Draw all figures; yield their names, too."""
        for filled in self.filled:
            if filled.values["seeds"].any():
                yield f"table-{filled.table.id}", figures.draw_bars(filled)
        if self.stored and len(self.finished):
            runs = self.finished[self.finished["directory"].isin(list(self.stored))]
            everything = bool(self.models)
            yield from figures.draw_predictions(runs, self.stored, self.scenarios, all_trajectories=everything)
        for sweep in self.sweeps:
            if (figure := draw_sweep(sweep)) is not None:
                yield f"sweep-{sweep.name}", figure
        yield from self._stability_distributions()
        if len(self.difficulty):
            yield from difficulty.draw(self.difficulty, self.scenarios)
        yield from self.supplement.figures.items()

    def _mse_by_difficulty(self, scores: Mapping[Path, Scores]) -> pd.DataFrame:
        """Return the lines of `cophy.report.difficulty.mse_by_difficulty` on the default split of each scenario."""
        if self.configurations.dataset is None or not self.stored or self.finished.empty:
            return pd.DataFrame()
        runs, frames = self.finished[self.finished["directory"].isin(list(self.stored))], []
        for (name, split, size), group in runs.groupby(["scenario", "split", "size"]):
            if split == self.scenarios[str(name)].task.splits[0]:
                part = self.configurations.default_split(str(name)).test
                states = self.configurations.dataset(str(name), part.num_objects, str(size))
                if states.is_finished():
                    frames.append(difficulty.mse_by_difficulty(group, scores, states.load(), states.spec, part))
        return pd.concat(frames) if frames else pd.DataFrame()

    def _stability_distributions(self) -> Iterator[tuple[str, Figure]]:
        """Draw the stability distribution of the tower datasets that the runs used."""
        if self.configurations.dataset is None or not self.scenarios:
            return
        for (name, size), group in self.finished.groupby(["scenario", "size"]):
            scenario = self.scenarios[str(name)]
            if scenario.statics is None:
                continue
            used, arrays = set(group["dataset_ids"].explode()), dict[int, dict[str, np.ndarray]]()
            for count in scenario.num_objects:
                states = self.configurations.dataset(str(name), count, str(size))
                if states.id in used and states.is_finished():
                    arrays[count] = states.load()
                elif states.id in used:
                    log.info(notice(f"{states.directory} does not exist: the report leaves out its figures."))
            if arrays:
                yield f"stability_distribution-{size}", figures.draw_stability_distribution(arrays)


def _remove_earlier(directory: Path, written: Collection[str]) -> None:
    """Remove the tables and figures of an earlier report that this one did not write.

    Args:
        written: Files of tables, and figures without suffix, of this report.
    """
    names = ["difficulty.csv", "difficulty.md", *(f"{table.id}.csv" for table in paper_tables())]
    for path in (directory / name for name in names if name not in written):
        if path.is_file():
            path.unlink()
    for path in (directory / "figures").glob("*.png"):
        of_figure = [path, path.with_suffix(".pdf")]  # a report writes both
        is_earlier = FIGURE.match(path.name) and f"figures/{path.stem}" not in written
        if is_earlier and all(file.is_file() for file in of_figure):
            for file in of_figure:
                file.unlink()


def write_report(
    outputs: Path,
    directory: Path,
    configurations: Configurations,
    supplement: Supplement | None = None,
    *,
    models: Sequence[str] = (),
    splits: Sequence[str] = (),
    paper: bool | None = None,
) -> None:
    """Print the report of a folder of runs, see `Report`, and write its files to a directory."""
    if not outputs.is_dir():
        raise CophyError(f"outputs={outputs}: there is no such folder; train.py writes runs there, study.py answers")
    report = Report(outputs, configurations, supplement or Supplement(), models, splits, paper)
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    drawn = dict(report.figures())
    paths = [directory / "figures" / name for name in drawn]
    with nullcontext() if len(drawn) < MANY_FIGURES else worker_pool(NUM_PROCESSES) as processes:
        written = (map if processes is None else processes.map)(write_figure, paths, drawn.values())
        tables = report.write_tables(directory)
        try:
            report.show()
        finally:  # whoever reads the output may have seen enough
            list(written)
            _remove_earlier(directory, {*tables, *(f"figures/{name}" for name in drawn)})
    unused = f" ({report.unused} more are left out, see above)" if report.unused else ""
    message = "%s%s; tables (md, tex, csv), their captions and %d figures (png, pdf) are in\n%s"
    log.info(message, "1 run" if len(report.runs) == 1 else f"{len(report.runs)} runs", unused, len(drawn), directory)
