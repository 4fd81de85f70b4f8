"""Prove the datasets of a split sound: python src/audit.py scenario=balls size=small (exit code 1 when they are not)"""

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from cophy import cli, config
from cophy.dataset.audit import audit
from cophy.dataset.states import States
from generate import specs

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    settings: config.GenerateConfig = cli.to_config(cfg)
    sound = True
    for spec in specs(settings):
        states = States(spec, Path(settings.data_dir))
        checks = list(audit(states.load(), spec))
        table = Table(
            "", "check", "found", title=f"{states.directory}: {spec.num_experiments} experiments", title_justify="left"
        )
        for check in checks:
            table.add_row("[green]ok[/]" if check.passed else "[bold red]FAILS[/]", check.name, check.found)
        Console().print(table)
        sound &= all(check.passed for check in checks)
    if not sound:
        sys.exit("audit: a check fails, see above")


if __name__ == "__main__":
    cli.run(main)
