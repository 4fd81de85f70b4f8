"""Audit the datasets of a split: python src/audit.py scenario=balls size=small (exit code 1 if a check fails)"""

import sys
from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import experiments_of, generated_by, to_config
from cophy.schemas import AuditConfig


@cli.command("audit")
def main(cfg: DictConfig) -> None:
    from cophy.audit.report import report_generated, report_released  # matplotlib takes a second to import

    settings = to_config(cfg, AuditConfig)
    if settings.source.is_generated:
        directory, pairs = Path(settings.directory), settings.replayed_pairs
        directory.mkdir(parents=True, exist_ok=True)  # fails before anything is generated
        failing = [
            line for s in generated_by(settings) for line in report_generated(s, directory, replayed_pairs=pairs)
        ]
    else:
        failing = [line for s in experiments_of(settings, settings.num_objects) for line in report_released(s)]
    if failing:
        sys.exit("audit: " + "\naudit: ".join(failing))
