"""From pictures to a counterfactual: python src/predict.py observed=AB/ initial=C.png derenderer=… predictor=…"""

import logging
from pathlib import Path

import hydra
import numpy as np
from omegaconf import DictConfig

from cophy import cli, config
from cophy.errors import CophyError

config.register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path="../conf", config_name="predict")
def main(cfg: DictConfig) -> None:
    from cophy.files import write_atomically
    from cophy.training import pictures
    from cophy.training.clips import gif
    from cophy.training.derenderers import TrainedDerenderer
    from cophy.training.inference import TrainedPredictor, predict, redraw

    settings: config.PredictConfig = cli.to_config(cfg)
    derenderer = TrainedDerenderer(Path(settings.derenderer))
    predictor = TrainedPredictor(Path(settings.predictor))
    if derenderer.scenario != predictor.scenario.name:
        raise CophyError(f"the de-renderer is of {derenderer.scenario}, the predictor of {predictor.scenario.name}")
    observed, initial = (pictures.read_frames(Path(path)) for path in (settings.observed, settings.initial))
    truth = None if settings.truth is None else pictures.read_frames(Path(settings.truth))
    if truth is not None and truth.shape != observed.shape:
        raise CophyError(f"truth has {truth.shape[:3]} frames, rows and columns, AB has {observed.shape[:3]}")
    found = predict(observed, initial[0], derenderer, predictor)
    directory = Path(settings.directory)
    directory.mkdir(parents=True, exist_ok=True)
    lines = ["frame,object,x_m,y_m,z_m"]
    for time, positions in enumerate(found.positions):
        lines += [
            f"{time},{name},{x:.4f},{y:.4f},{z:.4f}"
            for name, (x, y, z), present in zip(predictor.scenario.colors, positions, found.presence, strict=True)
            if present
        ]
    write_atomically(directory / "positions.csv", ("\n".join(lines) + "\n").encode())
    size = observed.shape[1]
    sequences = {"observed AB": observed} | ({} if truth is None else {"true CD": truth})
    sequences["predicted CD"] = redraw(found, predictor.scenario, size)
    clip = pictures.side_by_side(sequences)
    write_atomically(directory / "prediction.gif", gif(clip, frames_per_second=predictor.scenario.clock.frame_rate_hz))
    times = np.linspace(0, len(clip) - 1, 6).astype(int)
    pictures.write_picture(directory / "strip.png", pictures.grid([s[times] for s in sequences.values()]))
    names = [name for name, present in zip(predictor.scenario.colors, found.presence, strict=True) if present]
    log.info("%s: positions.csv, prediction.gif and strip.png; objects in C: %s", directory, ", ".join(names))


if __name__ == "__main__":
    cli.run(main)
