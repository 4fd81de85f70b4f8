"""Predict a counterfactual from images: python src/predict.py observed=AB/ initial=C.png derenderer=… predictor=…"""

import logging
from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import to_config
from cophy.schemas import SCENARIOS, PredictConfig

log = logging.getLogger(__name__)


@cli.command("predict")
def main(cfg: DictConfig) -> None:
    from cophy.atomic_files import write_atomically
    from cophy.drawing.counterfactual import write_counterfactual
    from cophy.drawing.files import read_frames
    from cophy.training.checkpoints import import_network_class
    from cophy.training.reprojection import in_words, to_csv
    from cophy.training.trained import TrainedDerenderer, TrainedPredictor, check_pair, error_in_images, predict

    settings = to_config(cfg, PredictConfig)
    derenderer = TrainedDerenderer(Path(settings.derenderer))
    name = settings.model_class
    model_class = None if name is None else import_network_class("model_class", name)
    predictor = TrainedPredictor(Path(settings.predictor), SCENARIOS, model_class)
    check_pair(derenderer, predictor)
    rate = predictor.scenario.clock.frame_rate_hz
    observed = read_frames(Path(settings.observed), frame_rate_hz=rate)
    initial = read_frames(Path(settings.initial))[0]
    truth = None if settings.truth is None else read_frames(Path(settings.truth), frame_rate_hz=rate)
    background = None if settings.background is None else read_frames(Path(settings.background))[0]
    directory, scenario = Path(settings.directory), predictor.scenario
    prediction = predict(observed, initial, derenderer, predictor)
    predicted = prediction.positions, prediction.presence, scenario
    write_counterfactual(directory, *predicted, observed=observed, truth=truth, background=background)
    evidence = prediction.observed, prediction.initial, scenario
    write_atomically(directory / "objects.csv", to_csv(*evidence).encode())
    for line in in_words(*evidence):
        log.info(line)
    if predictor.positions != "derendered" and (error := derenderer.test_error()):
        log.info("the predictor was trained on true positions; the de-renderer's test error is %s", error)
    if truth is not None:
        error_m2 = error_in_images(prediction, truth, derenderer, scenario.task.metric_dims)
        log.info("MSE of the prediction %.4f m², against what the de-renderer finds in truth=", error_m2)
    names = [name for name, present in zip(scenario.colors, prediction.presence, strict=True) if present]
    log.info(
        "%s: positions.csv, objects.csv, prediction.gif and strip.png; objects in C: %s", directory, ", ".join(names)
    )
