"""Export generated data in the format of CoPhy_224: python src/export.py scenario=balls root=/where/CoPhy_224"""

import logging
from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.archive import files_in_package
from cophy.schemas import ExportConfig

log = logging.getLogger(__name__)


@cli.command("export")
def main(cfg: DictConfig) -> None:
    from cophy.dataset import archive, parquet
    from cophy.released.export import export

    settings = to_config(cfg, ExportConfig)
    root = Path(settings.root)
    root.mkdir(parents=True, exist_ok=True)
    for states in generated_by(settings):
        has_images = settings.format == "cophy" if settings.images is None else settings.images
        images = states.frames(settings.render).best_available() if has_images else None
        if files_in_package(states):  # copied, not generated
            generation.ensure(states, workers=1)
        (states if images is None else images).finished_checksums()  # otherwise an error that names the command
        if settings.format == "parquet":
            log.info("%s", parquet.export(states, images, root))
        elif settings.format == "archive":
            log.info("%s", archive.write_archive(states, images, root))
        else:
            export(states, images, root)
