"""Tables and figures from outputs/, ours beside the paper's numbers: python src/report.py"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import to_config
from cophy.app.registration import register
from cophy.app.schemas import ReportConfig

register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="report")
def main(cfg: DictConfig) -> None:
    from cophy.app.report_choices import ComposedChoices
    from cophy.report.pipeline import write_report  # matplotlib takes a second to import; --help does not need it

    settings = to_config(cfg, ReportConfig)
    choices = ComposedChoices(settings.source.name, Path(settings.data_dir))
    twins = settings.source.is_generated  # only generated data have them
    write_report(Path(settings.outputs), Path(settings.directory), choices, has_twins=twins)


if __name__ == "__main__":
    cli.run(main)
