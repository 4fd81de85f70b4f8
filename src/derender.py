"""Positions and presence in every frame, as a de-renderer sees them: python src/derender.py scenario=balls size=small"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy import cli, config
from cophy.dataset import generation

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="derender")
def main(cfg: DictConfig) -> None:
    from cophy.dataset.estimates import Estimates  # torch takes seconds to import; --help does not need it
    from cophy.dataset.images import Images
    from cophy.dataset.source import pictures_of
    from cophy.training.derenderers import TrainedDerenderer, find

    settings: config.DerenderConfig = cli.to_config(cfg)
    settings.split.check_scenario(settings.scenario)
    counts = settings.num_objects or sorted({settings.split.train.num_objects, settings.split.test.num_objects})
    chosen = [
        settings.source.states(
            settings.scenario, count, split=settings.split, size=settings.size, seed=settings.seed,
            data_dir=Path(settings.data_dir),
        )
        for count in counts
    ]  # fmt: skip
    if settings.derenderer is not None:
        derenderer = TrainedDerenderer(Path(settings.derenderer))
    else:
        derenderer = find(Path(settings.outputs), settings.scenario.name, set(counts), settings.split.name)
    derenderer.check(chosen)
    for states in chosen:
        images = pictures_of(states, derenderer.render)
        estimates = Estimates(images, derenderer)
        generation.ensure(states, workers=settings.workers)
        if isinstance(images, Images) and not estimates.is_finished():
            generation.ensure(images, workers=settings.workers)
        generation.make(estimates, workers=settings.workers)


if __name__ == "__main__":
    cli.run(main)
