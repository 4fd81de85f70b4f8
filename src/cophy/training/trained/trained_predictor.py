"""Trained predictors: the network of a checkpoint, and the scenario that it was trained on."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from cophy.dataset.feed.batches import true_inputs
from cophy.dataset.feed.declared_inputs import DeclaredInputs
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.trained.checkpoints import made_from, read_bytes, read_checkpoint
from cophy.training.trained.network import restore_network
from cophy.training.trained.trained_derenderer import TARGET as DERENDERER

ALLOWED = "cophy.models."  # whose classes a checkpoint may name: importing any other module would run its code


class TrainedPredictor:
    """The network of a checkpoint, in evaluation mode, and the data that it was trained on.

    Args:
        source: The checkpoint.
        scenarios: The classes of scenarios by name.

    Attributes:
        source: The checkpoint.
        scenario: Of the data.
        size: Name of their size. Test it on data of this size: most test experiments of another are among those it was
            trained on.
        data_seed: Of the data.
        network: From `Inputs` to `Prediction`.
    """

    def __init__(self, source: Path, scenarios: Mapping[str, type[Scenario]]) -> None:
        checkpoint = read_checkpoint(read_bytes(source), source)
        model = checkpoint.origin.model
        target = str(model["_target_"])
        if not target.startswith(ALLOWED) or target == DERENDERER:
            raise CophyError(
                f"predictor={source} is a checkpoint of {target}: only predictors of cophy.models are loaded"
            )
        declared = DeclaredInputs.of(model)
        if declared.confounders:
            raise CophyError(f"predictor={source} wants the true confounders, which no picture shows")
        if declared.not_derendered:
            raise CophyError(f"predictor={source} has {declared.not_derendered}, which no de-renderer estimates")
        name = str(checkpoint.origin.scenario["name"])
        if name not in scenarios:
            raise CophyError(f"predictor={source} is of the scenario {name}, which is not known here")
        self.source, self.data_seed = source, checkpoint.origin.data_seed
        self.size = str(checkpoint.origin.size.get("name"))
        with made_from(source):
            self.scenario = _scenario(checkpoint.origin.scenario, scenarios[name])
            self.network = restore_network(model, checkpoint.weights).eval()

    def __call__(self, experiments: Mapping[str, Tensor]) -> Float[Tensor, "batch steps slots 3"]:
        """D of each experiment from its AB and C.

        Args:
            experiments: `states` and `presence` of some experiments, as a DataLoader batches those of `cophy.load`.
                Of CD only C is looked at.

        Returns:
            Positions in the frames after C, metres; zero in slots that C leaves empty.
        """
        inputs = true_inputs(experiments["states"].numpy(), experiments["presence"].numpy(), self.scenario)
        with torch.no_grad():
            return self.network(inputs).position * inputs.presence[:, None, :, None]


def _scenario(keys: dict[str, Any], schema: type[Scenario]) -> Scenario:
    scenario = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(schema), keys))
    assert isinstance(scenario, Scenario)
    return scenario
