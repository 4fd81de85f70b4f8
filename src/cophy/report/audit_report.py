"""An audit in the terminal, as a page with figures, and in the dataset's card."""

from pathlib import Path

from rich.console import Console
from rich.table import Table

from cophy.dataset import generation
from cophy.dataset.audit import Check, audit_generated, audit_released
from cophy.dataset.cards.dataset_card import write_card
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.dataset.store.states import States
from cophy.report.audit_page import write_page


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
