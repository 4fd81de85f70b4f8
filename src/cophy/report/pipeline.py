"""From outputs/ to tables and figures, ours next to the paper's numbers."""

import logging
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.drawing.plots import write_figure
from cophy.errors import CophyError
from cophy.report import figures, render
from cophy.report.overview import TWINS_CAPTION, overview_tables, summarize_runs, twin_tables
from cophy.report.paper_tables import paper_tables
from cophy.report.predictions import StoredPredictions, read_stored_predictions
from cophy.report.runs import DatasetIds, notice, read_runs
from cophy.report.tables import FilledTable, fill
from cophy.scenario import Scenario
from cophy.workers import worker_pool

log = logging.getLogger(__name__)

OVERVIEW = "MSE of the test split, m² (epochs of training × seeds)."
NUM_PROCESSES, MANY_FIGURES = 2, 16  # figures take most of the time of a report; from so many on, processes write them
MAX_FAILURES = 5  # printed; runs.csv has all
SUMMARY_COLUMNS = ("run", "seeds", "epochs", "training (s)", "mse", "final position error")  # in the terminal


@dataclass(frozen=True)
class Configurations:
    """What the names of runs stand for.

    Attributes:
        scenario: Returns the scenario of a name.
        default_split: Returns the default split of the scenario of a name.
        dataset: Returns a generated dataset, by name of the scenario, number of objects and name of the size; None where
            the runs are on other data, which have no twins, margins or balance.
        dataset_ids: See `read_runs`.
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
        tables: Title -> table of text.
        caption: Caption of these tables.
        figures: By name.
    """

    participants: pd.DataFrame | None = None
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    caption: str = ""
    figures: dict[str, Figure] = field(default_factory=dict)


class Report:
    """Tables and figures of the runs in a folder.

    Args:
        outputs: Where train.py wrote its runs.
        configurations: What the names of runs stand for.
        supplement: Results of human participants.
        show_all: Whether empty tables, captions and a line for each run are printed, and all trajectories drawn, too.

    Raises:
        CophyError: There is nothing to report.
    """

    def __init__(
        self, outputs: Path, configurations: Configurations, supplement: Supplement | None = None, *, show_all: bool
    ) -> None:
        runs = read_runs(outputs, configurations.dataset_ids)
        self.supplement, self.unused = supplement or Supplement(), runs.attrs["unused"]
        self.configurations, self.show_all = configurations, show_all
        self.stored: dict[Path, StoredPredictions] = {}
        if len(runs):
            predictors = runs[runs["error"].isna() & ~runs["model"].str.startswith("derenderer")]
            self.stored = read_stored_predictions(predictors, configurations.scenario)
            self.unused += len(predictors) - len(self.stored)
            runs = runs[~runs["directory"].isin(set(predictors["directory"]) - set(self.stored))]
        if runs.empty and not self.supplement.tables:
            if self.unused:
                raise CophyError(f"outputs={outputs}: no run can be reported, for the reasons above")
            raise CophyError(f"outputs={outputs}: there are no runs; train.py writes them (python src/train.py --help)")
        self.runs = runs if len(runs) else pd.DataFrame()
        self.finished = runs[runs["error"].isna()] if len(runs) else self.runs
        names = self.finished["scenario"].unique() if len(self.finished) else ()
        self.scenarios = {str(name): configurations.scenario(str(name)) for name in names}
        scores = {directory: predictions.scores for directory, predictions in self.stored.items()}
        self.filled = [fill(table, self.runs, scores, self.supplement.participants) for table in paper_tables()]
        self.twins, self.difficulty = twin_tables(self.runs), self._mse_by_difficulty()

    def show(self) -> None:
        """Print what was run and the paper's tables as far as runs fill them."""
        tables = overview_tables(self.runs)
        for number, (title, table) in enumerate(tables.items(), start=1):
            render.show(f"What was run: {title}", table, OVERVIEW if number == len(tables) else "")
        self._show_failures()
        for filled in self.filled:
            self._show_table(filled)
        empty = sum(not filled.has_runs for filled in self.filled)
        if empty and not self.show_all:
            log.info(notice(f"{empty} tables have no runs yet: all=true prints them."))
        for title, table in self.twins.items():
            render.show(title, table)
        if self.twins:
            log.info(notice(TWINS_CAPTION))
        for title, table in self.supplement.tables.items():
            render.show(title, table, self.supplement.caption)
        if self.show_all and len(self.runs):
            summary = summarize_runs(self.runs)
            columns = [name for name in SUMMARY_COLUMNS if name in summary]
            render.show("Everything that was run", summary[columns].set_index("run"))

    def _show_failures(self) -> None:
        failed = self.runs[self.runs["error"].notna()].to_dict("records") if len(self.runs) else []
        for run in failed[:MAX_FAILURES]:
            log.info(notice(f"failed: {run['directory']}: {run['error']}"))
        if failed:
            log.info(notice("Run the same command again, or remove the folder of a failed run to forget it."))

    def _show_table(self, filled: FilledTable) -> None:
        if not filled.has_runs and not self.show_all:
            return
        cells, shares = render.table_cells(filled), render.share_cells(filled)
        if self.show_all:
            render.show(filled.table.title, cells, render.caption(filled))
        else:
            better = "Lower" if filled.table.lower_is_better else "Higher"
            caption = f"Ours, the paper's below it. {better} is better. {filled.left_out}".strip()
            render.show(filled.table.title, render.filled_only(cells), caption)
        if len(shares):
            render.show(render.SHARE, shares if self.show_all else render.filled_only(shares))

    def write_tables(self, directory: Path) -> None:
        """Write all tables as Markdown, LaTeX and CSV."""
        texts = self._tables()
        if len(self.difficulty):
            from cophy.report import difficulty

            texts["difficulty.csv"] = self.difficulty.to_csv(index=False)
            texts["difficulty.md"] = difficulty.page(self.difficulty, self.scenarios)
        for name, text in texts.items():
            write_atomically(directory / name, text.encode())

    def _tables(self) -> dict[str, str]:
        """Return the content of the files of tables by name; tables with something of ours come first."""
        filled = sorted(self.filled, key=lambda table: not table.has_runs)
        parts = [
            "\n".join(map(render.markdown, filled)),
            render.markdown_sections(self.twins, TWINS_CAPTION),
            render.markdown_sections(self.supplement.tables, self.supplement.caption),
            f"\n## Everything that was run\n\n{summarize_runs(self.runs).to_markdown(index=False)}\n",
        ]
        return {
            "tables.md": "".join(parts),
            "tables.tex": "\n".join(map(render.latex, filled)),
            "runs.csv": self.runs.to_csv(index=False),
            **{f"{table.table.id}.csv": table.values.to_csv(index=False) for table in filled},
        }

    def figures(self) -> Iterator[tuple[str, Figure]]:
        """Draw all figures; yield their names, too."""
        for filled in self.filled:
            if filled.values["seeds"].any():
                yield f"table-{filled.table.id}", figures.draw_bars(filled)
        if self.stored:
            runs = self.finished[self.finished["directory"].isin(list(self.stored))]
            yield from figures.draw_predictions(runs, self.stored, self.scenarios, all_trajectories=self.show_all)
        yield from self._stability_distributions()
        if len(self.difficulty):
            from cophy.report import difficulty

            yield from difficulty.draw(self.difficulty, self.scenarios)
        yield from self.supplement.figures.items()

    def _mse_by_difficulty(self) -> pd.DataFrame:
        """Return the lines of `cophy.report.difficulty.mse_by_difficulty` on the default split of each scenario."""
        if self.configurations.dataset is None or not self.stored:
            return pd.DataFrame()
        runs, frames = self.finished[self.finished["directory"].isin(list(self.stored))], []
        for (name, split, size), group in runs.groupby(["scenario", "split", "size"]):
            if split == self.scenarios[str(name)].task.splits[0]:
                part = self.configurations.default_split(str(name)).test
                states = self.configurations.dataset(str(name), part.num_objects, str(size))
                if states.is_finished():
                    from cophy.report import difficulty  # imports torch, which takes seconds; most reports need none

                    frames.append(difficulty.mse_by_difficulty(group, states.load(), states.spec, part))
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


def write_report(
    outputs: Path,
    directory: Path,
    configurations: Configurations,
    supplement: Supplement | None = None,
    *,
    show_all: bool,
) -> None:
    """Print the report of a folder of runs, see `Report`, and write its files to a directory."""
    if not outputs.is_dir():
        raise CophyError(f"outputs={outputs}: there is no such folder; train.py writes runs there, study.py answers")
    report = Report(outputs, configurations, supplement, show_all=show_all)
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    drawn = dict(report.figures())
    paths = [directory / "figures" / name for name in drawn]
    with nullcontext() if len(drawn) < MANY_FIGURES else worker_pool(NUM_PROCESSES) as processes:
        written = (map if processes is None else processes.map)(write_figure, paths, drawn.values())
        report.write_tables(directory)
        report.show()
        list(written)
    unused = f" ({report.unused} more are left out, see above)" if report.unused else ""
    message = "%s%s; tables (md, tex, csv), their captions and %d figures (png, pdf) are in\n%s"
    log.info(message, "1 run" if len(report.runs) == 1 else f"{len(report.runs)} runs", unused, len(drawn), directory)
