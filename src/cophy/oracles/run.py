"""The run of an oracle: how far a predictor can get, by the forecasts of the simulator (docs/benchmark/oracles.md)."""

import time
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from cophy.dataset import generation
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.errors import CophyError
from cophy.oracles.forecasts import OracleSettings, oracle_forecasts
from cophy.training.evaluation import evaluate, mse_of_copies
from cophy.training.figures import NUM_SHOWN, Curves, DrawnPredictions
from cophy.training.run import Claim, Measured, is_first, write_metrics, write_predictions
from cophy.training.trainer import finishing, log_results, loggers_of
from cophy.types import Prediction, take

MIN_PROBABILITY = 1e-6  # of being stable, and of not, so that its logit is finite


def carry_out_oracle(
    claim: Claim,
    data: CounterfactualDataModule,
    oracle: str,
    settings: OracleSettings,
    *,
    loggers: dict[str, Any],
    started: float,
) -> None:
    """Test what an oracle forecasts; nothing is trained.

    Args:
        claim: The run's names and place.
        data: Set up; true positions.
        oracle: One of ORACLES. "feedforward": the mean of D over what could be, given A, C and the do-operation. No
            predictor without AB beats it in expectation. "initial_velocity": given that of A, too. "confounders": given
            these instead. "counterfactual": given AB instead.
        settings: What the oracles are asked with.
        loggers: What `logger=` chose.
        started: `time.monotonic()` when the run began.
    """
    prediction = forecast(data, oracle, settings)
    asked = take(data.test.batch, slice(len(prediction.position)))
    targets = asked.targets
    claim.begin(tests_checkpoint=False)
    if not is_first():
        return
    run = claim.run
    copies = mse_of_copies(asked, data.scenario, data.mean_position)
    measured = Measured(evaluate(prediction, targets, data.scenario), targets.pair.numpy(), copies)
    write_predictions(run.directory, prediction, targets)
    about = {
        "dataset_ids": data.dataset_ids,
        "derenderer": None,
        "num_train": len(data.train),
        "num_test": len(asked),
        "training_seconds": 0.0,
        "wall_seconds": round(time.monotonic() - started, 1),
    }
    metrics = write_metrics(run, measured, about)
    chosen = loggers_of(run, loggers)
    with finishing(chosen):
        for logger in chosen:
            logger.log_hyperparams(run.names() | {f"model.{key}": value for key, value in asdict(settings).items()})
            if isinstance(logger, Curves):
                shown = take(asked, slice(NUM_SHOWN))
                drawn = DrawnPredictions(shown, data.scenario, "test")
                drawn.add(logger.experiment, take(prediction, slice(NUM_SHOWN)), step=0)
        log_results(chosen, metrics, step=0)


def forecast(data: CounterfactualDataModule, oracle: str, settings: OracleSettings) -> Prediction:
    """What an oracle says of the first test experiments; forecasts that are missing are simulated first.

    Args:
        data: Set up.
        oracle: One of ORACLES.
        settings: What the oracles are asked with.

    Raises:
        CophyError: None of the split's test experiments is among those that the oracles are asked about.
    """
    forecasts = oracle_forecasts(data.test_set, settings)
    generation.ensure(forecasts, workers=data.workers)
    stored = forecasts.load()
    chosen = np.flatnonzero(np.isin(stored["experiment"], data.test_experiments))
    if not len(chosen):
        raise CophyError(f"split={data.split.name} tests on none of the experiments that oracles are asked about")
    position, stable, by_chance = (
        torch.from_numpy(stored[f"{oracle}_{what}"][chosen]) for what in ("position", "stable", "draw_variance")
    )
    return Prediction(position, torch.logit(stable, eps=MIN_PROBABILITY), draw_variance=by_chance)
