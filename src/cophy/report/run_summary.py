"""Print the results of a run: its test MSE next to copy baselines, the paper's number and the oracles."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cophy.atomic_files import read_json
from cophy.errors import CophyError
from cophy.report.paper_tables import published_mse
from cophy.report.predictions import stored_scores
from cophy.report.render import interval
from cophy.report.runs import read_line
from cophy.report.tables import PAPER_SIZES, share_of_gain
from cophy.training.run import METRICS, Run, short_keys

ENDS_OF_SHARE = ("oracle_feedforward", "oracle_counterfactual")  # without AB, with AB
COPIES = {"copy_c": "copy C: nothing moves", "copy_b": "copy B: the do-operation changes nothing"}
OF_SAMPLES = {"energy_score": "Energy score of the samples, m", "best_sample_mse": "MSE of the best sample, m²"}
IN_PERCENT = {
    "twin_difference_explained": "Explained part of the twins' difference",
    "right_twin_chosen": "Right twin chosen",
}


def show_results(run: Run, own_metrics: Iterable[str] = ()) -> None:
    """Print a small table of the metrics.json of a finished run with the user's own metrics, and its path."""
    content = read_json(run.directory / METRICS)
    words = short_keys(run.changes)
    changes = [f"{words[key]}={value}" for key, value in run.changes.items()]  # tells the runs of a sweep apart
    title = ", ".join([f"{run.model} ({run.ablation}) on {run.scenario} {run.split}", f"seed {run.seed}", *changes])
    table = Table(box=SIMPLE_HEAD, title=escape(title), title_justify="left")
    table.add_column(f"{content['num_test']} test experiments")
    table.add_column("", justify="right", no_wrap=True)
    for line in _lines(run, content, own_metrics):
        table.add_row(*line)
    console = Console()
    console.print(table)
    console.print(f"Results: {run.directory}", soft_wrap=True, highlight=False)


def _lines(run: Run, content: dict[str, Any], own_metrics: Iterable[str]) -> Iterator[tuple[str, str]]:
    metrics = content["metrics"]
    low, high = content["intervals"]["mse"]
    yield f"MSE, m²{', with 95 % interval' if low < high else ''}", _with_interval(content, "mse")
    for name, value in content["copies"].items():
        yield f"  {COPIES[name]}", f"{value:.4f}"
    if (published := published_mse(run.names())) is not None:
        more = "" if content["size"] in PAPER_SIZES else ", from more experiments"
        yield f"  the paper's number of this row{more}", f"{published:.3f}"
    for name, title in OF_SAMPLES.items():
        if name in metrics:
            yield title, _with_interval(content, name)
    for name, title in IN_PERCENT.items():
        if name in metrics:
            yield title, _with_interval(content, name, ".1%")
    if content["copies"] and not metrics.keys() & IN_PERCENT.keys():  # a de-renderer has no copies, and no twins
        yield "No twin pairs in the test split: no measures of twins", ""
    for name in own_metrics:
        yield name, _with_interval(content, name)
    if run.root is None or run.positions != "ground_truth" or run.model.startswith(("oracle", "derenderer")):
        return
    oracles = [_oracle(run.root / run.scenario / run.split / name, content) for name in ENDS_OF_SHARE]
    if None not in oracles:
        lines = [{"directory": path, "metric_dims": content["metric_dims"]} for path in (run.directory, *oracles)]
        try:
            share = share_of_gain(*([stored_scores(line)] for line in lines))
        except (CophyError, OSError):  # damaged predictions of an oracle; report.py names them
            return
        if not np.isnan(share.value):
            yield "Share of the possible gain", f"{share.value:.0%} {interval(share.low, share.high, '.0%')}".strip()


def _with_interval(content: dict[str, Any], name: str, form: str = ".4f") -> str:
    """Return a mean and its interval, if it has a width."""
    low, high = content["intervals"][name]
    return f"{content['metrics'][name]:{form}} {interval(low, high, form)}".strip()


def _oracle(directory: Path, content: dict[str, Any]) -> Path | None:
    """Return the run of an oracle that was tested on the first experiments of the same test split, or on all of them.

    Of several runs, it is the one that changes least beyond its names.
    """
    for path in sorted(directory.glob(f"full/ground_truth/seed*/{METRICS}"), key=lambda path: len(path.parent.name)):
        try:
            other = read_line(path)
        except (CophyError, OSError):  # a file that train.py did not write; report.py names it
            continue
        if other["dataset_ids"] == content["dataset_ids"] and other["num_test"] <= content["num_test"]:
            return path.parent
    return None
