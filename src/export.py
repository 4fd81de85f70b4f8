"""Generated data in the format of a released dataset: python src/export.py scenario=balls root=/where/CoPhy_224"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import to_config
from cophy.app.datasets import generated_by
from cophy.app.registration import register
from cophy.app.schemas import ExportConfig

register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="export")
def main(cfg: DictConfig) -> None:
    from cophy.dataset.released.export.exporter import export

    settings = to_config(cfg, ExportConfig)
    for states in generated_by(settings):
        images = states.frames(settings.render)
        images.ensure(workers=settings.workers)
        export(images, Path(settings.root))


if __name__ == "__main__":
    cli.run(main)
