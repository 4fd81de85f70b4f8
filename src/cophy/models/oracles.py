"""How far a predictor can get: the best forecasts that the simulator allows, without and with AB."""

import torch
from torch import nn

from cophy.types import Batch, Prediction


class Oracle(nn.Module):
    """The mean of D over all that could be: nothing to learn.

    oracle: "feedforward" (given A, C and the do-operation: no predictor without AB beats it in expectation, up to the
    sampling error of its draws) or "counterfactual" (given AB too). draws, noise: of `cophy.scenario.hypotheses`, from whose
    simulations `Batch.oracle_position` and `oracle_stable` come.
    """

    def __init__(self, *, oracle: str, draws: int, noise: float) -> None:
        super().__init__()
        self.oracle, self.draws, self.noise = oracle, draws, noise

    def forward(self, batch: Batch) -> Prediction:
        """What was simulated for this batch."""
        if batch.oracle_position is None or batch.oracle_stable is None:
            raise ValueError("oracles forecast test experiments only, from simulations that come with the batch")
        return Prediction(batch.oracle_position, torch.logit(batch.oracle_stable, eps=1e-6))
