"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import to_config
from cophy.app.datasets import generated_by
from cophy.app.registration import register
from cophy.app.schemas import GenerateConfig
from cophy.dataset import generation

register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    settings = to_config(cfg, GenerateConfig)
    for states in generated_by(settings):
        generation.make(states, workers=settings.workers)
        if settings.render.modalities:
            generation.make(states.frames(settings.render), workers=settings.workers)


if __name__ == "__main__":
    cli.run(main)
