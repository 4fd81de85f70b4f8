"""Oracles as models of train.py: how far a predictor can get, by forecasts of the simulator (docs/benchmark/metrics.md)."""

import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from torch import nn

from cophy.dataset import generation
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.drawing.tensorboard import NUM_DRAWN, DrawnPredictions
from cophy.errors import CophyError
from cophy.oracles.forecasts import OracleForecasts, OracleSettings
from cophy.training.predictor import PredictionModule
from cophy.types import Batch, Inputs, Prediction, take

MIN_PROBABILITY = 1e-6  # of being stable and of moving, so that the logit is finite


class OracleModule(PredictionModule):
    """Tests the forecasts of an oracle for the first test experiments; there is nothing to train or to validate."""

    network: "Oracle"

    def make_figures(self, every_n_epochs: int) -> L.Callback:
        return L.Callback()  # figures are drawn after the test

    def validation_step(self, batch: Batch) -> None: ...

    def on_validation_epoch_end(self) -> None: ...

    def test_step(self, batch: Batch) -> None: ...

    def check_batches(self, inputs: Inputs) -> None: ...

    def on_test_epoch_end(self) -> None:
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        prediction, rows = self.network.forecast(data)
        batch = take(data.test.batch, torch.from_numpy(rows))
        self.tested = prediction, batch, rows
        logger = next((each for each in self.trainer.loggers if isinstance(each, TensorBoardLogger)), None)
        if logger is not None and self.trainer.is_global_zero:
            drawn = DrawnPredictions(take(batch, slice(NUM_DRAWN)), self.scenario, "test")
            drawn.add(logger.experiment, take(prediction, slice(NUM_DRAWN)), step=0)


class Oracle(nn.Module):
    """Mean of D over simulations that are consistent with what the oracle is given.

    Args:
        oracle: One of ORACLES. "feedforward": given A, C and the do-operation; no predictor without AB beats it in
            expectation. "initial_velocity": given that of A, too. "confounders": given these instead. "counterfactual":
            given AB instead.
        draws, max_configurations, noise, max_experiments: See `OracleSettings`.
    """

    module_class = OracleModule  # what tests it
    needs_true_positions = True

    def __init__(self, *, oracle: str, draws: int, max_configurations: int, noise: float, max_experiments: int) -> None:
        super().__init__()
        self.oracle = oracle
        self.settings = OracleSettings(draws, max_configurations, noise, max_experiments)

    def forecast(self, data: CounterfactualDataModule) -> tuple[Prediction, np.ndarray]:
        """Return the oracle's prediction of some test experiments, and their rows in the test split.

        Missing forecasts are simulated first.

        Raises:
            CophyError: The split tests on none of the experiments that have forecasts.
        """
        forecasts = OracleForecasts(data.test_set, self.settings)
        generation.ensure(forecasts, workers=data.workers)
        arrays = forecasts.load()
        _, rows, tested = np.intersect1d(arrays["experiment"], data.test_experiments, return_indices=True)
        if not len(rows):
            raise CophyError(f"split={data.split.name} tests on none of the experiments that oracles forecast")
        position, stable, variance = (
            torch.from_numpy(arrays[f"{self.oracle}_{name}"][rows]) for name in ("position", "stable", "draw_variance")
        )
        return Prediction(position, torch.logit(stable, eps=MIN_PROBABILITY), draw_variance=variance), tested
