"""Tables and figures from outputs/, ours beside the paper's numbers: python src/report.py"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy import cli
from cophy.config import CONF, to_config
from cophy.schemas import ReportConfig, register

register()


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="report")
@cli.in_one_line
def main(cfg: DictConfig) -> None:
    from cophy.report.pipeline import write_report  # matplotlib takes a second to import; --help does not need it
    from cophy.report_choices import ComposedChoices

    settings = to_config(cfg, ReportConfig)
    choices = ComposedChoices(settings.source.name, Path(settings.data_dir))
    twins = settings.source.is_generated  # only generated data have them
    write_report(Path(settings.outputs), Path(settings.directory), choices, has_twins=twins, show_all=settings.all)


def run() -> None:
    """The command, as `pip install` puts it on the PATH."""
    cli.run(main)
