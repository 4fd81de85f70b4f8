"""From pictures to a counterfactual: python src/predict.py observed=AB/ initial=C.png derenderer=… predictor=…"""

import logging
from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import CONF, to_config
from cophy.app.schemas.commands import PredictConfig
from cophy.app.schemas.registration import SCENARIOS, register

register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="predict")
@cli.in_one_line
def main(cfg: DictConfig) -> None:
    from cophy.drawing.counterfactual_files import write_counterfactual
    from cophy.drawing.picture_files import read_frames
    from cophy.training.trained.counterfactual_prediction import check_pair, predict
    from cophy.training.trained.trained_derenderer import TrainedDerenderer
    from cophy.training.trained.trained_predictor import TrainedPredictor

    settings = to_config(cfg, PredictConfig)
    derenderer = TrainedDerenderer(Path(settings.derenderer))
    predictor = TrainedPredictor(Path(settings.predictor), SCENARIOS)
    check_pair(derenderer, predictor)
    observed, initial = read_frames(Path(settings.observed)), read_frames(Path(settings.initial))[0]
    truth = None if settings.truth is None else read_frames(Path(settings.truth))
    background = None if settings.background is None else read_frames(Path(settings.background))[0]
    directory, scenario = Path(settings.directory), predictor.scenario
    found = predict(observed, initial, derenderer, predictor)
    predicted = found.positions, found.presence, scenario
    write_counterfactual(directory, *predicted, observed=observed, truth=truth, background=background)
    names = [name for name, present in zip(scenario.colors, found.presence, strict=True) if present]
    log.info("%s: positions.csv, prediction.gif and strip.png; objects in C: %s", directory, ", ".join(names))


def run() -> None:
    """The command, as `pip install` puts it on the PATH."""
    cli.run(main)
