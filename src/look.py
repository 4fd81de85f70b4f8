"""Pictures of a dataset for people: python src/look.py scenario=balls"""

import logging
from pathlib import Path

import hydra
import numpy as np
from omegaconf import DictConfig
from tqdm import tqdm

from cophy import cli, config
from cophy.dataset import generation
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import States
from cophy.errors import CophyError
from generate import specs

config.register()
log = logging.getLogger(__name__)
NUM_STRIP_FRAMES = 6


@hydra.main(version_base="1.3", config_path="../conf", config_name="look")
def main(cfg: DictConfig) -> None:
    from cophy.files import write_atomically
    from cophy.scenario.rendering import Renderer
    from cophy.training import pictures
    from cophy.training.clips import gif

    settings: config.LookConfig = cli.to_config(cfg)
    train = settings.split.train.num_objects
    spec = next((spec for spec in specs(settings) if spec.num_objects == train), specs(settings)[0])
    states = States(spec, Path(settings.data_dir))
    generation.ensure(states, workers=settings.workers)
    arrays, directory = states.load(), Path(settings.directory)
    if not 0 <= settings.experiment < spec.num_experiments:
        raise CophyError(f"experiment={settings.experiment} is not among the {spec.num_experiments} of {spec.id}")
    with Renderer(spec.scenario, settings.render.resolution, settings.render.backend) as renderer:
        shown = range(0, min(2 * settings.num_shown, spec.num_experiments), 2)  # of every twin pair the first
        rows = [
            [frame for s in (0, 1) for frame in pictures.render_sequence(renderer, arrays, row, s, [0, -1]).rgb]
            for row in tqdm(shown, desc="contact sheet")
        ]
        pictures.write_picture(directory / "sheet.png", pictures.grid(rows))
        observed, counterfactual = (
            pictures.render_sequence(renderer, arrays, settings.experiment, sequence, slice(None))
            for sequence in tqdm((0, 1), desc="experiment")
        )
    times = np.linspace(0, spec.scenario.clock.num_frames - 1, NUM_STRIP_FRAMES).astype(int)
    pictures.write_picture(directory / "strip.png", pictures.grid([f.rgb[times] for f in (observed, counterfactual)]))
    middle = spec.scenario.clock.num_frames // 3
    kinds = [
        observed.rgb[middle],
        pictures.depth_in_grey(observed.depth[middle]),
        pictures.segmentation_in_color(observed.segmentation[middle], spec.scenario),
    ]
    pictures.write_picture(directory / "modalities.png", pictures.grid([kinds]))
    clip = pictures.side_by_side({"observed AB": observed.rgb, "counterfactual CD": counterfactual.rgb})
    write_atomically(directory / "clip.gif", gif(clip, frames_per_second=spec.scenario.clock.frame_rate_hz))
    for name, frames in (("AB", observed.rgb), ("CD", counterfactual.rgb)):
        for time, frame in enumerate(frames):
            pictures.write_picture(directory / name / f"{time:02d}.png", frame)
    log.info(
        "%s: sheet.png (A, B, C, D of %d experiments); strip.png, modalities.png, clip.gif and the frames of experiment %d (%s split)",
        *(directory, len(shown), settings.experiment, SPLITS[arrays["split"][settings.experiment]]),
    )


if __name__ == "__main__":
    cli.run(main)
