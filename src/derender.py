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
        counts = {spec.num_objects for spec in chosen}
        derenderer = find(Path(settings.outputs), settings.scenario.name, counts, settings.split.name)
    derenderer.check(chosen)
    for spec in chosen:
        states = States(spec, Path(settings.data_dir))
        images = Images(states, derenderer.render)
        estimates = Estimates(images, derenderer)
        generation.ensure(states, workers=settings.workers)
        if not estimates.is_finished():
            generation.ensure(images, workers=settings.workers)
        generation.make(estimates, workers=settings.workers)


if __name__ == "__main__":
    cli.run(main)
