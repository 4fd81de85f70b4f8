"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

from collections.abc import Iterator

import hydra
from omegaconf import DictConfig

from cophy import cli
from cophy.config import CONF, generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.experiment_set import FRAMES
from cophy.dataset.shards import ShardSet
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.schemas import GenerateConfig, register

register()


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="generate")
@cli.in_one_line
def main(cfg: DictConfig) -> None:
    settings = to_config(cfg, GenerateConfig)
    for states in generated_by(settings):
        for shards in asked_for(states, settings):
            if not (shards is states or states.is_finished()):
                raise CophyError(
                    f"{states.directory}: other parts are not whole yet; run the same command once they are"
                )
            generation.make_part(shards, settings.part, settings.parts, workers=settings.workers)


def asked_for(states: States, settings: GenerateConfig) -> Iterator[ShardSet]:
    """The states, and what is made of them."""
    yield states
    if settings.render.modalities:
        yield states.frames(settings.render, FRAMES[settings.frames])
    if settings.model is not None:
        yield states.forecasts(settings.model.settings)


def run() -> None:
    """The command, as `pip install` puts it on the PATH."""
    cli.run(main)
