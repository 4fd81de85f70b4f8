"""From outputs/ to tables and figures, ours next to the paper's numbers."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.report import difficulty, figures, render
from cophy.report.overview import TWINS_CAPTION, group_runs, overview_tables, short_columns, twin_tables
from cophy.report.paper_tables import paper_tables
from cophy.report.predictions import StoredPredictions, read_stored_predictions
from cophy.report.runs import DatasetIds, notice, read_runs, summarize_runs
from cophy.report.tables import FilledTable, fill
from cophy.scenario import Scenario

log = logging.getLogger(__name__)

OVERVIEW = "MSE of the test split, m² (epochs of training × seeds)."
MAX_FAILURES = 5  # printed; runs.csv has all
SUMMARY_COLUMNS = ("run", "seeds", "epochs", "training (s)", "mse", "final position error")  # in the terminal


@dataclass(frozen=True)
class Configurations:
    """What the configuration says about the names of runs.

    Attributes:
        scenario: Returns the scenario of a name.
        split: Returns a split, by names of scenario and split.
        dataset: Returns a generated dataset, by name of the scenario, number of objects and name of the size; None where
            the runs are on other data, which have no twins, margins or balance.
        dataset_ids: See `read_runs`.
    """

    scenario: Callable[[str], Scenario]
    split: Callable[[str, str], Split]
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
        self.runs = read_runs(outputs, configurations.dataset_ids)
        self.supplement = supplement or Supplement()
        self.configurations, self.show_all = configurations, show_all
        if self.runs.empty and not self.supplement.tables:
            if self.runs.attrs["unused"]:
                raise CophyError(f"outputs={outputs}: no run can be reported, for the reasons above")
            raise CophyError(f"outputs={outputs}: there are no runs; train.py writes them (python src/train.py --help)")
        self.stored = self._read_predictions()

    def _read_predictions(self) -> dict[Path, StoredPredictions]:
        """Return the predictions of the finished predictors by directory; drop the runs whose predictions are damaged."""
        if self.runs.empty:
            return {}
        is_predictor = self.runs["error"].isna() & ~self.runs["model"].str.startswith("derenderer")
        predictors = self.runs[is_predictor]
        whole = [path for _, _, _, group in self._difficulty_groups(predictors) for path in group["directory"]]
        stored = read_stored_predictions(predictors, whole)
        self.runs = self.runs[~is_predictor | self.runs["directory"].isin(list(stored))]
        return stored

    @property
    def predictors(self) -> pd.DataFrame:
        """The finished runs with predictions."""
        if self.runs.empty:  # only human participants are reported
            return self.runs
        return self.runs[self.runs["directory"].isin(list(self.stored)) & self.runs["error"].isna()]

    @cached_property
    def scenarios(self) -> dict[str, Scenario]:
        """The scenarios of the finished runs by name."""
        names = self.runs.loc[self.runs["error"].isna(), "scenario"].unique() if len(self.runs) else ()
        return {str(name): self.configurations.scenario(str(name)) for name in names}

    @cached_property
    def filled(self) -> list[FilledTable]:
        """The paper's tables with our numbers."""
        return [
            fill(table, self.runs, lambda run: self.stored[run["directory"]].errors, self.supplement.participants)
            for table in paper_tables()
        ]

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
            log.info(notice(f"{empty} tables have nothing of ours yet: all=true prints them."))
        self._show_twins()
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

    def _show_twins(self) -> None:
        tables = {
            f"{title}: {kind}": table
            for kind, runs in group_runs(self.runs)
            for title, table in twin_tables(runs).items()
        }
        for title, table in tables.items():
            render.show(title, table.set_axis(short_columns(table.columns), axis=1))
        if tables:
            log.info(notice(TWINS_CAPTION))

    def write(self, directory: Path) -> None:
        """Write all tables as Markdown, LaTeX and CSV, and all figures as PNG and PDF."""
        (directory / "figures").mkdir(parents=True, exist_ok=True)
        lines = self.mse_by_difficulty()
        texts = self._tables()
        if len(lines):
            texts |= {
                "difficulty.csv": lines.to_csv(index=False),
                "difficulty.md": difficulty.page(lines, self.scenarios),
            }
        for name, text in texts.items():
            write_atomically(directory / name, text.encode())
        drawn = self._figures(lines)
        for name, figure in drawn.items():
            figures.write_figure(directory / "figures", name, figure)
        skipped = self.runs.attrs["skipped"]
        unreadable = f" ({skipped} more cannot be read, see above)" if skipped else ""
        message = "%d runs%s; tables (md, tex, csv), their captions and %d figures (png, pdf) are in\n%s"
        log.info(message, len(self.runs), unreadable, len(drawn), directory)

    def _tables(self) -> dict[str, str]:
        """Return the content of the files of tables by name; tables with something of ours come first."""
        filled = sorted(self.filled, key=lambda table: not table.has_runs)
        parts = [
            "\n".join(map(render.markdown, filled)),
            render.markdown_sections(twin_tables(self.runs), TWINS_CAPTION),
            render.markdown_sections(self.supplement.tables, self.supplement.caption),
            f"\n## Everything that was run\n\n{summarize_runs(self.runs).to_markdown(index=False)}\n",
        ]
        return {
            "tables.md": "".join(parts),
            "tables.tex": "\n".join(map(render.latex, filled)),
            "runs.csv": self.runs.to_csv(index=False),
            **{f"{table.table.id}.csv": table.values.to_csv(index=False) for table in filled},
        }

    def _figures(self, lines: pd.DataFrame) -> dict[str, Figure]:
        drawn = {
            f"table-{filled.table.id}": figures.draw_bars(filled)
            for filled in self.filled
            if filled.values["seeds"].any()
        }
        if len(self.predictors):
            drawn |= dict(
                figures.draw_predictions(self.predictors, self.stored, self.scenarios, all_trajectories=self.show_all)
            )
        drawn |= self._stability_distributions()
        if len(lines):
            drawn |= dict(difficulty.draw(lines, self.scenarios))
        return drawn | self.supplement.figures

    def _difficulty_groups(self, runs: pd.DataFrame) -> list[tuple[str, str, str, pd.DataFrame]]:
        """Return scenario, split, size and runs of those on the default split of each scenario whose dataset exists."""
        if self.configurations.dataset is None:
            return []
        default = {name: scenario.task.splits[0] for name, scenario in self.scenarios.items()}
        groups = runs[runs["split"] == runs["scenario"].map(default)].groupby(["scenario", "split", "size"])
        named = [(str(scenario), str(split), str(size), group) for (scenario, split, size), group in groups]
        return [each for each in named if self._test_set(each[0], each[1], each[2]).is_finished()]

    def _test_set(self, scenario: str, split: str, size: str) -> States:
        assert self.configurations.dataset is not None
        return self.configurations.dataset(scenario, self.configurations.split(scenario, split).test.num_objects, size)

    def mse_by_difficulty(self) -> pd.DataFrame:
        """Return the lines of `cophy.report.difficulty.mse_by_difficulty` on the default split of each scenario."""
        frames = []
        for scenario, split, size, group in self._difficulty_groups(self.predictors) if len(self.predictors) else ():
            states, part = self._test_set(scenario, split, size), self.configurations.split(scenario, split).test
            frames.append(difficulty.mse_by_difficulty(group, self.stored, states.load(), states.spec, part))
        return pd.concat(frames) if frames else pd.DataFrame()

    def _stability_distributions(self) -> dict[str, Figure]:
        """Draw the stability distribution of the tower datasets that the runs used."""
        if self.configurations.dataset is None or self.runs.empty:
            return {}
        finished, drawn = self.runs[self.runs["error"].isna()], {}
        for (name, size), group in finished.groupby(["scenario", "size"]):
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
                drawn[f"stability_distribution-{size}"] = figures.draw_stability_distribution(arrays)
        return drawn


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
    report.show()
    report.write(directory)
