"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy import cli, config
from cophy.dataset import generation
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    settings: config.GenerateConfig = cli.to_config(cfg)
    for spec in specs(settings):
        states = States(spec, Path(settings.data_dir))
        generation.make(states, workers=settings.workers)
        if settings.render.modalities:
            generation.make(Images(states, settings.render), workers=settings.workers)


def specs(settings: config.DataConfig) -> list[DatasetSpec]:
    """The datasets that the split, or num_objects, names."""
    settings.split.check_scenario(settings.scenario)
    counts = settings.num_objects or sorted({settings.split.train.num_objects, settings.split.test.num_objects})
    return [DatasetSpec(settings.scenario, count, settings.size, settings.seed) for count in counts]


if __name__ == "__main__":
    cli.run(main)
