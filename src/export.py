"""Generated data in the layout of a released dataset: python src/export.py scenario=balls root=/where/CoPhy_224"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy import cli, config
from cophy.dataset import generation
from cophy.dataset.external.export import export
from cophy.dataset.images import Images
from cophy.dataset.states import States
from generate import specs

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="export")
def main(cfg: DictConfig) -> None:
    settings: config.ExportConfig = cli.to_config(cfg)
    for spec in specs(settings):
        states = States(spec, Path(settings.data_dir))
        images = Images(states, settings.render)
        generation.ensure(states, workers=settings.workers)
        generation.ensure(images, workers=settings.workers)
        export(images, Path(settings.root))


if __name__ == "__main__":
    cli.run(main)
