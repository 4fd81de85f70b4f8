"""Positions and presence in every frame, as a de-renderer sees them: python src/derender.py scenario=balls size=small"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy import cli, config
from cophy.dataset import generation
from cophy.dataset.states import States
from generate import specs

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="derender")
def main(cfg: DictConfig) -> None:
    from cophy.dataset.estimates import Estimates  # torch takes seconds to import; --help does not need it
    from cophy.dataset.images import Images
    from cophy.training.derenderers import TrainedDerenderer, find

    settings: config.DerenderConfig = cli.to_config(cfg)
    chosen = specs(settings)
    if settings.derenderer is not None:
        derenderer = TrainedDerenderer(Path(settings.derenderer))
    else:
        derenderer = find(Path(settings.outputs), settings.scenario.name, {spec.num_objects for spec in chosen})
    for spec in chosen:
        states = States(spec, Path(settings.data_dir))
        images = Images(states, derenderer.render)
        generation.ensure(states, workers=settings.workers)
        generation.ensure(images, workers=settings.workers)
        generation.make(Estimates(images, derenderer), workers=settings.workers)


if __name__ == "__main__":
    cli.run(main)
