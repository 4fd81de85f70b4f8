"""What the two copies, which need no training, score on a test split: every MSE is read beside theirs."""

from jaxtyping import Float
from torch import Tensor

from cophy.bootstrap import mean
from cophy.models.baselines import CopyB, CopyC
from cophy.scenario import Scenario
from cophy.training.measures.metrics import position_measures
from cophy.training.prediction_module import place_missed
from cophy.types import Batch


def mse_of_copies(batch: Batch, scenario: Scenario, missed_position: Float[Tensor, "3"]) -> dict[str, float]:
    """Test MSE, m², of copy C ("D is C") and of copy B ("D is B").

    Args:
        batch: The test split.
        scenario: Says which coordinates count.
        missed_position: Where an object is predicted that the de-renderer missed in C, metres.
    """
    mse = position_measures(scenario.task)["mse"]
    copies = {"copy_c": CopyC(), "copy_b": CopyB()}
    found = {name: place_missed(copy(batch.inputs), batch, missed_position) for name, copy in copies.items()}
    return {name: mean(mse(prediction, batch.targets).double().numpy()) for name, prediction in found.items()}
