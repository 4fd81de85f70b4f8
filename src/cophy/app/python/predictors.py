"""Trained predictors from Python, without a command line: `cophy.load_predictor`."""

from pathlib import Path

from cophy.app.schemas.registration import SCENARIOS
from cophy.training.trained.trained_predictor import TrainedPredictor


def load_predictor(checkpoint: str | Path) -> TrainedPredictor:
    """A trained predictor: called with a batch of experiments, it says what D would be.

    Args:
        checkpoint: Of train.py, for example outputs/…/checkpoints/best.ckpt. Reading it runs no code of it.

    Raises:
        CophyError: The file is something else, or its predictor is given the true confounders.
    """
    return TrainedPredictor(Path(checkpoint), SCENARIOS)
