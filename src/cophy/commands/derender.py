"""Positions and presence in frames, as a de-renderer sees them: python src/derender.py scenario=balls size=small"""

from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import experiments_of, to_config
from cophy.dataset.experiment_set import FRAMES
from cophy.schemas import DerenderConfig


@cli.command("derender")
def main(cfg: DictConfig) -> None:
    from cophy.training.trained import TrainedDerenderer, derender, find_derenderer  # --help does not wait for torch

    settings = to_config(cfg, DerenderConfig)
    sets = experiments_of(settings, settings.num_objects)
    if settings.derenderer is not None:
        derenderer = TrainedDerenderer(Path(settings.derenderer))
    else:
        counts = set(settings.split.counts(settings.num_objects))
        derenderer = find_derenderer(Path(settings.outputs), sets, counts, settings.split.name)
    part, parts = settings.part, settings.parts
    needed = FRAMES[settings.frames]
    derender(sets, derenderer, needed, part=part, parts=parts, workers=settings.workers)
