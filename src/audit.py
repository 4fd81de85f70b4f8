"""Prove the datasets of a split sound: python src/audit.py scenario=balls size=small (exit code 1 when they are not)"""

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from cophy import cli, config
from cophy.dataset.audit import audit
from cophy.dataset.card import write_card
from cophy.dataset.states import States
from cophy.report.audit_page import write_page
from generate import specs

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="audit")
def main(cfg: DictConfig) -> None:
    settings: config.AuditConfig = cli.to_config(cfg)
    failing = []
    for spec in specs(settings):
        states = States(spec, Path(settings.data_dir))
        arrays = states.load()
        checks = list(audit(arrays, spec, replayed_pairs=settings.replayed_pairs))
        table = Table(
            "", "check", "found", title=f"{states.directory}: {spec.num_experiments} experiments", title_justify="left"
        )
        for check in checks:
            table.add_row("[green]ok[/]" if check.passed else "[bold red]FAILS[/]", check.name, check.found)
        page = write_page(checks, arrays, spec, Path(settings.directory) / spec.id)
        Console().print(table, f"with figures: {page}", soft_wrap=False)
        wrong = [check.name for check in checks if not check.passed]
        said = (
            f"{len(wrong)} of {len(checks)} lines fail: {'; '.join(wrong)}"
            if wrong
            else f"all {len(checks)} lines hold"
        )
        write_card(spec, states.directory, f"{said} ({settings.replayed_pairs} twin pairs simulated again)")
        failing += [f"{spec.id}: {check.name}: {check.found}" for check in checks if not check.passed]
    if failing:
        sys.exit("audit: " + "\naudit: ".join(failing))


if __name__ == "__main__":
    cli.run(main)
