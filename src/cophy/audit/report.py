"""An audit in the terminal, as a page with figures, and as a line in the dataset's card."""

import errno
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from cophy.atomic_files import write_atomically
from cophy.audit.bias import ClassifierCheck, check_bias, check_stored_order
from cophy.audit.checks import (
    Check,
    check_cell_shapes,
    check_distances,
    check_effects,
    check_first_frames,
    check_shares,
    check_states,
    check_towers,
    check_twins,
    distances_per_value,
)
from cophy.audit.released import audit_released
from cophy.audit.resimulation import check_convergence, check_identifiability, check_resimulation
from cophy.dataset import generation
from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.shards import Arrays
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States, sort_by_twins
from cophy.report.figures import BLUE, GREY, ORANGE, draw_stability_distribution

log = logging.getLogger(__name__)


def audit_generated(arrays: Arrays, spec: DatasetSpec, *, replayed_pairs: int) -> Iterator[Check]:
    """Yield all checks of a generated dataset; loading it has already verified every checksum.

    Args:
        arrays: arrays of the whole dataset, see `sort_by_twins`.
        replayed_pairs: how many twin pairs are regenerated and resimulated, also under other confounders.
    """
    yield from check_states(arrays, spec)
    yield from check_twins(arrays, spec)
    yield from check_effects(arrays, spec)
    yield from check_first_frames(arrays, spec.num_objects)
    yield from check_shares(arrays, spec)
    if spec.scenario.statics is not None:
        yield from check_towers(arrays, spec, spec.scenario.statics)
    else:
        yield from check_cell_shapes(arrays, spec)
        yield from check_distances(arrays, spec)
    yield from check_bias(arrays, spec)
    yield from check_stored_order(arrays, spec)
    yield from check_resimulation(arrays, spec, replayed_pairs)
    yield from check_convergence(arrays, spec, replayed_pairs)
    yield from check_identifiability(arrays, spec, replayed_pairs)


def report_generated(states: States, directory: Path, *, replayed_pairs: int) -> list[str]:
    """Audit a generated dataset: print a table, write a page, and update the dataset's card.

    Args:
        directory: where the page is written, in a folder named after the dataset.

    Returns:
        A line for every check that fails.
    """
    spec = states.spec
    arrays = sort_by_twins(states.load(), spec)
    checks = list(audit_generated(arrays, spec, replayed_pairs=replayed_pairs))
    page = write_page(checks, arrays, spec, directory / spec.id)
    _print_table(f"{states.directory}: {spec.num_experiments} experiments", checks, f"with figures: {page}")
    failing = [check.name for check in checks if not check.passed]
    summary = f"all {len(checks)} lines hold"
    if failing:
        summary = f"{len(failing)} of {len(checks)} lines fail: {'; '.join(failing)}"
    try:
        states.write_card(f"{summary} ({min(replayed_pairs, len(arrays['twin']) // 2)} twin pairs resimulated)")
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        log.warning("%s: the result is not added to the dataset's card (%s)", states.directory, error.strerror)
    return _failing_lines(spec.id, checks)


def report_released(experiments: ExperimentSet) -> list[str]:
    """Audit a released dataset: print a table of the checks that apply to it; return a line for each that fails."""
    generation.make(experiments, workers=1)
    spec, arrays = experiments.spec, experiments.load()
    checks = list(audit_released(arrays, spec))
    _print_table(f"{experiments.title}: {spec.num_experiments} folders", checks, f"index: {experiments.directory}")
    return _failing_lines(experiments.id, checks)


def _failing_lines(name: str, checks: list[Check]) -> list[str]:
    return [f"{name}: {check.name}: {check.result}" for check in checks if not check.passed]


def _print_table(title: str, checks: list[Check], footer: str) -> None:
    table = Table("", "check", "result", title=title, title_justify="left")
    for check in checks:
        table.add_row("[green]ok[/]" if check.passed else "[bold red]FAILS[/]", check.name, check.result)
    Console().print(table, footer, soft_wrap=False)


def write_page(checks: Sequence[Check], arrays: Arrays, spec: DatasetSpec, directory: Path) -> Path:
    """Write audit.md and its figures into a directory, and return the path of audit.md."""
    directory.mkdir(parents=True, exist_ok=True)
    figures = {}
    if (outcomes := draw_outcomes(arrays, spec)) is not None:
        figures["Outcomes of CD for every value of the confounders"] = ("outcomes.png", outcomes)
    if classifiers := [check for check in checks if isinstance(check, ClassifierCheck)]:
        figures["Predictions of CD without the motion of AB"] = ("bias.png", draw_classifiers(classifiers))
    for name, figure in figures.values():
        figure.savefig(directory / name, dpi=100)
    failing = sum(not check.passed for check in checks)
    lines = [
        f"# Audit of {spec.scenario.name}, {spec.id}\n",
        f"{spec.num_experiments} experiments; {failing or 'no'} of {len(checks)} lines fail.\n",
        "| | check | result |\n|---|---|---|",
        *(f"| {'ok' if check.passed else '**FAILS**'} | {check.name} | {check.result} |" for check in checks),
        *(f"\n![{title}]({name})" for title, (name, _) in figures.items()),
    ]
    page = directory / "audit.md"
    write_atomically(page, ("\n".join(lines) + "\n").encode())
    return page


def draw_classifiers(checks: Sequence[ClassifierCheck]) -> Figure:
    """Draw each classifier's accuracy as a bar with its interval, over the accuracy by chance (grey)."""
    figure = Figure(figsize=(9, 0.9 + 0.38 * len(checks)), layout="constrained")
    axis = figure.subplots()
    y = -np.arange(len(checks), dtype=float)
    accuracy, chance, low, high = (
        100 * np.array([getattr(check, name) for check in checks]) for name in ("accuracy", "chance", "low", "high")
    )
    axis.barh(y, chance, height=0.74, color=GREY, label="by chance")
    colors = [BLUE if check.passed else ORANGE for check in checks]
    axis.barh(y, accuracy, height=0.4, color=colors, label="classifier, 95 % interval")
    axis.errorbar(accuracy, y, xerr=(accuracy - low, high - accuracy), fmt="none", ecolor="black", capsize=3, lw=1)
    axis.axvline(50, color="black", lw=0.8, ls="--")
    for row, share, end in zip(y, accuracy, np.maximum(high, chance), strict=True):
        axis.text(end + 1.5, row, f"{share:.1f} %", va="center", fontsize="small")
    axis.set_yticks(y, [check.name for check in checks], fontsize="small")
    axis.set(xlim=(0, 108), xticks=range(0, 101, 10), xlabel="accuracy, %")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize="small")
    return figure


def draw_outcomes(arrays: Arrays, spec: DatasetSpec) -> Figure | None:
    """Draw outcomes of CD per value of every confounder: share of towers that stand (paper Fig. 3), or distances.

    Returns None where no confounder of objects has two values.
    """
    if spec.scenario.statics is not None:
        return draw_stability_distribution({spec.num_objects: arrays})
    distances = {name: values for name, values in distances_per_value(arrays, spec).items() if len(values) > 1}
    if not distances:
        return None
    figure = Figure(figsize=(3.6 * len(distances), 3.4), layout="constrained")
    axes = figure.subplots(1, len(distances), sharey=True, squeeze=False)[0]
    for axis, (name, values) in zip(axes, distances.items(), strict=True):
        for value, samples in values.items():
            axis.ecdf(samples[np.isfinite(samples)], label=f"{value:g}")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("mean distance from the start in CD, m", fontsize="small")
        axis.legend(frameon=False)
        axis.grid(alpha=0.2)
    figure.axes[0].set_ylabel("share of objects")
    return figure
