"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

from collections.abc import Iterator

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.experiment_set import FRAMES
from cophy.dataset.shards import ShardSet
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.oracles.forecasts import OracleForecasts
from cophy.schemas import GenerateConfig


@cli.command("generate")
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
        yield OracleForecasts(states, settings.model)
