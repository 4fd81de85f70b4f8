"""Prove the datasets of a split sound: python src/audit.py scenario=balls size=small (exit code 1 when they are not)"""

import sys
from collections.abc import Iterator
from pathlib import Path

import hydra
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from cophy import cli, config
from cophy.dataset import generation
from cophy.dataset.audit import Check, audit, audit_external
from cophy.dataset.card import write_card
from cophy.dataset.states import States
from cophy.report.audit_page import write_page
from generate import specs

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="audit")
def main(cfg: DictConfig) -> None:
    settings: config.AuditConfig = cli.to_config(cfg)
    failing = []
    for name, checks in audited(settings) if settings.source.is_generated else audited_external(settings):
        failing += [f"{name}: {check.name}: {check.found}" for check in checks if not check.passed]
    if failing:
        sys.exit("audit: " + "\naudit: ".join(failing))


def audited(settings: config.AuditConfig) -> Iterator[tuple[str, list[Check]]]:
    """Generated datasets: a table, a page with figures, and a line in the dataset's card."""
    for spec in specs(settings):
        states = States(spec, Path(settings.data_dir))
        arrays = states.load()
        checks = list(audit(arrays, spec, replayed_pairs=settings.replayed_pairs))
        page = write_page(checks, arrays, spec, Path(settings.directory) / spec.id)
        show(f"{states.directory}: {spec.num_experiments} experiments", checks, f"with figures: {page}")
        wrong = [check.name for check in checks if not check.passed]
        said = (
            f"{len(wrong)} of {len(checks)} lines fail: {'; '.join(wrong)}"
            if wrong
            else f"all {len(checks)} lines hold"
        )
        write_card(spec, states.directory, f"{said} ({settings.replayed_pairs} twin pairs simulated again)")
        yield spec.id, checks


def audited_external(settings: config.AuditConfig) -> Iterator[tuple[str, list[Check]]]:
    """Released datasets: a table of the checks that apply to data of others."""
    settings.split.check_scenario(settings.scenario)
    objects = settings.num_objects or sorted({settings.split.train.num_objects, settings.split.test.num_objects})
    for count in objects:
        states = settings.source.states(
            settings.scenario, count, split=settings.split, size=settings.size, seed=0, data_dir=Path(settings.data_dir)
        )
        generation.make(states, workers=1)
        arrays = states.load()
        checks = list(audit_external(arrays, states.spec))
        show(f"{states.spec.directory}: {states.spec.num_experiments} folders", checks, f"index: {states.directory}")
        yield states.id, checks


def show(title: str, checks: list[Check], below: str) -> None:
    """A table of checks, in the terminal."""
    table = Table("", "check", "found", title=title, title_justify="left")
    for check in checks:
        table.add_row("[green]ok[/]" if check.passed else "[bold red]FAILS[/]", check.name, check.found)
    Console().print(table, below, soft_wrap=False)


if __name__ == "__main__":
    cli.run(main)
