"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

from collections.abc import Iterator

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import CONF, to_config
from cophy.app.datasets import generated_by
from cophy.app.schemas.commands import GenerateConfig
from cophy.app.schemas.registration import register
from cophy.dataset import generation
from cophy.dataset.pictures.needed_frames import FRAMES
from cophy.dataset.store.shardset import ShardSet
from cophy.dataset.store.states import States
from cophy.errors import CophyError

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
