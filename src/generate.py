"""Generate the datasets a split needs: python src/generate.py scenario=balls size=small"""

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import to_config
from cophy.app.datasets import generated_by
from cophy.app.registration import register
from cophy.app.schemas import GenerateConfig
from cophy.dataset import generation
from cophy.dataset.store.shardset import ShardSet
from cophy.errors import CophyError

register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    settings = to_config(cfg, GenerateConfig)
    for states in generated_by(settings):
        _make(states, settings)
        if not settings.render.modalities:
            continue
        if not states.is_finished():
            raise CophyError(
                f"{states.directory}: other parts are not whole yet; start again once they are, then pictures follow"
            )
        _make(states.frames(settings.render), settings)


def _make(shards: ShardSet, settings: GenerateConfig) -> None:
    if settings.parts == 1:
        generation.make(shards, workers=settings.workers)
    else:
        generation.make_part(shards, settings.part, settings.parts, workers=settings.workers)


if __name__ == "__main__":
    cli.run(main)
