"""From outputs/ to tables and figures, ours beside the paper's numbers."""

import io
import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.atomic_files import write_atomically
from cophy.dataset.store.states import States
from cophy.report import difficulty_page, figures
from cophy.report.choices import Choices
from cophy.report.mse_by_difficulty import mse_by_difficulty
from cophy.report.stability_distribution import draw_stability_distribution
from cophy.report.tables import table_formats
from cophy.report.tables.filled_tables import FilledTable, fill
from cophy.report.tables.paper_tables import paper_tables
from cophy.report.tables.run_table import read_runs, summary
from cophy.report.tables.shares import stored_errors
from cophy.report.tables.twin_table import CAPTION, twin_tables
from cophy.scenario import Scenario

log = logging.getLogger(__name__)

SHOWN = ("run", "seeds", "training (s)", "mse", "final position error")  # of the summary, in the terminal


def write_report(outputs: Path, directory: Path, choices: Choices, *, has_twins: bool) -> None:
    """Print the paper's tables as far as runs fill them; write them, and figures.

    Args:
        outputs: Where train.py wrote its runs.
        directory: Where tables and figures go.
        choices: What the names of runs stand for.
        has_twins: Whether the data have twins, margins and balance, as generated ones have.
    """
    (directory / "figures").mkdir(parents=True, exist_ok=True)
    runs = read_runs(outputs, choices.keys_of)
    filled = [fill(table, runs, stored_errors) for table in paper_tables()]
    drawn = _show_tables(filled)
    twins = twin_tables(runs)
    _show_twins(twins)
    _write_tables(directory, filled, twins, runs)
    finished = runs[runs["error"].isna()] if len(runs) else runs
    if len(finished):
        scenarios = {str(name): choices.scenario(str(name)) for name in finished["scenario"].unique()}
        drawn |= dict(figures.of_predictions(finished, scenarios))
        if has_twins:
            drawn |= _stability_distributions(finished, scenarios, choices)
            drawn |= _write_difficulty(directory, finished, scenarios, choices)
    for name, figure in drawn.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=110)
        write_atomically(directory / "figures" / f"{name}.png", picture.getvalue())
    log.info("%d runs; tables (md, tex, csv) and %d figures in %s", len(runs), len(drawn), directory)


def _show_tables(filled: list[FilledTable]) -> dict[str, Figure]:
    """Print what is filled; the same as bars."""
    drawn = {}
    for result in filled:
        if not result.values[["seeds", "failed"]].to_numpy().any():
            log.info("%s: nothing was run yet", result.table.title)
            continue
        table_formats.show(result.table.title, table_formats.for_terminal(result), result.caption)
        if (shares := result.shares()) is not None:
            table_formats.show(table_formats.SHARE, shares.reset_index(names=""), "")
        drawn[f"table-{result.table.id}"] = figures.draw_bars(result)
    return drawn


def _write_tables(
    directory: Path, filled: list[FilledTable], twins: Mapping[str, pd.DataFrame], runs: pd.DataFrame
) -> None:
    """Tables as Markdown, LaTeX and CSV, and a summary of everything that was run, which is printed too.

    Args:
        directory: Where they go.
        filled: The paper's tables.
        twins: Title to table, see `twin_tables`.
        runs: See `read_runs`.
    """
    everything = summary(runs)
    if len(everything):
        caption = "Mean over seeds, ± standard deviation where there are several. All metrics: tables.md, runs.csv."
        shown = [name for name in SHOWN if name in everything]
        table_formats.show("Everything that was run", everything[shown], caption)
    written = {
        "tables.md": "\n".join(map(table_formats.markdown, filled))
        + _twin_sections(twins)
        + f"\n## Everything that was run\n\n{everything.to_markdown(index=False)}\n",
        "tables.tex": "\n".join(map(table_formats.latex, filled)),
        "runs.csv": runs.to_csv(index=False),
        **{f"{result.table.id}.csv": result.values.to_csv(index=False) for result in filled},
    }
    for name, text in written.items():
        write_atomically(directory / name, text.encode())


def _show_twins(twins: Mapping[str, pd.DataFrame]) -> None:
    """Print what predictions tell of twins; one caption is for all tables."""
    for number, (title, table) in enumerate(twins.items(), start=1):
        table_formats.show(title, table.reset_index(names=""), CAPTION if number == len(twins) else "")


def _twin_sections(twins: Mapping[str, pd.DataFrame]) -> str:
    """The same as sections of Markdown."""
    sections = [f"\n## {title}\n\n{table.to_markdown()}\n" for title, table in twins.items()]
    return "".join([*sections, f"\n{CAPTION}\n"]) if sections else ""


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
    write_atomically(directory / "difficulty.md", difficulty_page.page(lines, scenarios).encode())
    return dict(difficulty_page.draw(lines, scenarios))


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
    log.info("%s is not there: the report does without what only the dataset tells", states.directory)
    return None
