"""Draw images of a dataset: python src/look.py scenario=balls"""

import logging
from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, require_scenario, to_config
from cophy.dataset import generation
from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.schemas import LookConfig

log = logging.getLogger(__name__)


@cli.command("look")
def main(cfg: DictConfig) -> None:
    from cophy.drawing.overview import (
        write_contact_sheet,
        write_experiment,
        write_frames,
        write_modalities,
        write_twins,
    )
    from cophy.scenario.rendering import Renderer

    settings = to_config(cfg, LookConfig)
    require_scenario()
    sets = generated_by(settings)
    trained_on = (states for states in sets if states.spec.num_objects == settings.split.train.num_objects)
    states, directory = next(trained_on, sets[0]), Path(settings.directory)
    directory.mkdir(parents=True, exist_ok=True)  # fails before anything is generated
    generation.ensure(states, workers=settings.workers)
    spec, arrays = states.spec, states.load()
    if not 0 <= settings.experiment < spec.num_experiments:
        raise CophyError(f"experiment={settings.experiment} is not among the {spec.num_experiments} of {spec.id}")
    dataset = spec.scenario, arrays, settings.render
    num_experiments = write_contact_sheet(directory / "sheet.png", *dataset, settings.num_shown)
    first, second = np.flatnonzero(spec.order.pair == spec.order.pair[settings.experiment]).tolist()
    write_twins(directory / "twins.png", *dataset, (first, second))
    write_modalities(directory / "modalities.png", *dataset, settings.experiment)
    write_experiment(directory, *dataset, settings.experiment)
    with Renderer(spec.scenario, settings.render.resolution, settings.render.backend) as renderer:
        write_frames(directory, renderer, arrays, settings.experiment)
    split = SPLITS[arrays["split"][settings.experiment]]
    log.info(
        "%s: sheet.png (A, B, C, D of %d experiments); of experiment %d (%s split) twins.png, strip.png, modalities.png, clip.gif, "
        "every frame in AB/ and CD/, and background.png without objects",
        *(directory, num_experiments, settings.experiment, split),
    )
