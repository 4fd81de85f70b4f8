"""An audit in the terminal, as a page with figures, and in the dataset's card.

All that can be checked of data that were generated here.
The page of an audit: every line, and what is behind it in pictures.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from cophy.audit.bias import bias
from cophy.audit.checks import Arrays, Check, ClassifierCheck
from cophy.audit.data import (
    do_operations_matter,
    geometries,
    paths_per_value,
    shapes,
    shares,
    states,
    towers,
    trajectories,
    twins,
)
from cophy.audit.released import audit_released
from cophy.audit.simulated import convergence, identifiability, simulation
from cophy.dataset import generation
from cophy.dataset.cards import write_card
from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.report.figures import BLUE, GREY, RED, draw_stability_distribution


def audit_generated(arrays: Arrays, spec: DatasetSpec, *, replayed_pairs: int) -> Iterator[Check]:
    """All checks on a loaded dataset; loading it has already verified every checksum.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        replayed_pairs: how many twin pairs are made and simulated again, and under other confounders.
    """
    yield from states(arrays, spec)
    yield from twins(arrays, spec)
    yield from do_operations_matter(arrays, spec)
    yield from geometries(arrays, spec.num_objects)
    yield from shares(arrays, spec)
    if spec.scenario.statics is not None:
        yield from towers(arrays, spec, spec.scenario.statics)
    else:
        yield from shapes(arrays, spec)
        yield from trajectories(arrays, spec)
    yield from bias(arrays, spec)
    yield from simulation(arrays, spec, replayed_pairs)
    yield from convergence(arrays, spec, replayed_pairs)
    yield from identifiability(arrays, spec, replayed_pairs)
    simulations = arrays["pair_simulations"][::2].sum() / len(arrays["twin"])
    yield Check("simulations per experiment", f"{simulations:.2f}", True)


def write_page(checks: Sequence[Check], arrays: dict[str, np.ndarray], spec: DatasetSpec, directory: Path) -> Path:
    """Write audit.md and its figures.

    Args:
        checks: The lines of the audit.
        arrays: The dataset.
        spec: Its description.
        directory: Where they go.

    Returns:
        The page.
    """
    directory.mkdir(parents=True, exist_ok=True)
    failing = sum(not check.passed for check in checks)
    lines = [f"| {'ok' if check.passed else '**FAILS**'} | {check.name} | {check.found} |" for check in checks]
    pictures = {}
    if (outcomes := draw_outcomes(arrays, spec)) is not None:
        pictures["Outcomes of CD for every value of the confounders"] = ("outcomes.png", outcomes)
    if asked := [check for check in checks if isinstance(check, ClassifierCheck)]:
        pictures["What can be known of CD without the motion of AB"] = ("bias.png", draw_classifiers(asked))
    for name, figure in pictures.values():
        figure.savefig(directory / name, dpi=100)
    page = directory / "audit.md"
    page.write_text(
        f"# Audit of {spec.scenario.name}, {spec.id}\n\n{spec.num_experiments} experiments; "
        f"{failing or 'no'} of {len(checks)} lines fail.\n\n| | check | found |\n|---|---|---|\n"
        + "\n".join(lines)
        + "".join(f"\n\n![{title}]({name})" for title, (name, _) in pictures.items())
        + "\n"
    )
    return page


def draw_classifiers(checks: Sequence[ClassifierCheck]) -> Figure:
    """Bars: each classifier's share of right guesses, with its interval, over the share by chance (grey).

    A classifier that is no better than chance has learned nothing.
    """
    figure = Figure(figsize=(9, 0.9 + 0.38 * len(checks)), layout="constrained")
    axis = figure.subplots()
    at = -np.arange(len(checks), dtype=float)
    accuracy, chance, low, high = (
        100 * np.array([getattr(check, name) for check in checks]) for name in ("accuracy", "chance", "low", "high")
    )
    axis.barh(at, chance, height=0.74, color=GREY, label="by chance")
    colors = [BLUE if check.passed else RED for check in checks]
    axis.barh(at, accuracy, height=0.4, color=colors, label="classifier, 95 % interval")
    axis.errorbar(accuracy, at, xerr=(accuracy - low, high - accuracy), fmt="none", ecolor="black", capsize=3, lw=1)
    axis.axvline(50, color="black", lw=0.8, ls="--")
    for place, share, end in zip(at, accuracy, np.maximum(high, chance), strict=True):
        axis.text(end + 1.5, place, f"{share:.1f} %", va="center", fontsize="small")
    axis.set_yticks(at, [check.name for check in checks], fontsize="small")
    axis.set_xlim(0, 108)
    axis.set_xticks(range(0, 101, 10))
    axis.set_xlabel("right guesses, %")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize="small")
    return figure


def draw_outcomes(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> Figure | None:
    """Outcomes of CD for every value of every confounder: towers that stand (paper Fig. 3), or lengths of paths.

    None where no confounder of objects has two values.
    """
    if spec.scenario.statics is not None:
        return draw_stability_distribution({spec.num_objects: arrays})
    paths = {name: values for name, values in paths_per_value(arrays, spec).items() if len(values) > 1}
    if not paths:
        return None
    figure = Figure(figsize=(3.6 * len(paths), 3.4), layout="constrained")
    for axis, (name, values) in zip(
        figure.subplots(1, len(paths), sharey=True, squeeze=False)[0], paths.items(), strict=True
    ):
        for value, lengths in values.items():
            axis.ecdf(lengths[np.isfinite(lengths)], label=f"{value:g}")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("mean distance from the start in CD, m", fontsize="small")
        axis.legend(frameon=False)
        axis.grid(alpha=0.2)
    figure.axes[0].set_ylabel("share of objects")
    return figure


def report_generated(states: States, directory: Path, *, replayed_pairs: int) -> list[str]:
    """Audit a generated dataset: a table, a page, and a line in the dataset's card.

    Args:
        states: The dataset.
        directory: Where the page goes, in a folder of the dataset's own.
        replayed_pairs: How many twin pairs are made and simulated again.

    Returns:
        A line for every check that fails.
    """
    spec, arrays = states.spec, states.load()
    checks = list(audit_generated(arrays, spec, replayed_pairs=replayed_pairs))
    page = write_page(checks, arrays, spec, directory / spec.id)
    _show(f"{states.directory}: {spec.num_experiments} experiments", checks, f"with figures: {page}")
    wrong = [check.name for check in checks if not check.passed]
    said = f"{len(wrong)} of {len(checks)} lines fail: {'; '.join(wrong)}" if wrong else f"all {len(checks)} lines hold"
    write_card(spec, states.directory, f"{said} ({replayed_pairs} twin pairs simulated again)")
    return _failing(spec.id, checks)


def report_released(experiments: ExperimentSet) -> list[str]:
    """Audit a released dataset: a table of the checks that apply to data of others; returns a line for each that fails."""
    generation.make(experiments, workers=1)
    spec, arrays = experiments.spec, experiments.load()
    checks = list(audit_released(arrays, spec))
    _show(f"{experiments.title}: {spec.num_experiments} folders", checks, f"index: {experiments.directory}")
    return _failing(experiments.id, checks)


def _failing(name: str, checks: list[Check]) -> list[str]:
    return [f"{name}: {check.name}: {check.found}" for check in checks if not check.passed]


def _show(title: str, checks: list[Check], below: str) -> None:
    table = Table("", "check", "found", title=title, title_justify="left")
    for check in checks:
        table.add_row("[green]ok[/]" if check.passed else "[bold red]FAILS[/]", check.name, check.found)
    Console().print(table, below, soft_wrap=False)
