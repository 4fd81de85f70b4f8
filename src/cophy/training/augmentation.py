"""Every training experiment, turned and mirrored at random as the symmetries of its scenario allow."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cophy.dataset.splits import Part
from cophy.scenario import Scenario
from cophy.types import HORIZONTAL, Batch


def symmetries_for(part: Part, scenario: Scenario) -> np.ndarray:
    """(symmetry, 2, 2) matrices: the scenario's, or the identity alone where training is on seen configurations (†).

    Turning an experiment turns its gravity too. That can make it an experiment of an unseen configuration.
    """
    return scenario.symmetries() if part.configurations is None else scenario.symmetries()[:1]


def augment(batch: Batch, symmetries: Float[Tensor, "symmetry 2 2"]) -> Batch:
    """Apply to each experiment one of the symmetries, drawn at random."""
    choice = torch.randint(len(symmetries), (len(batch),), device=symmetries.device)
    return transform(batch, symmetries[choice])


def transform(batch: Batch, matrices: Float[Tensor, "batch 2 2"]) -> Batch:
    """The batch in other coordinates: each matrix acts on x and y of AB, C, D and the confounders alike."""
    inputs, targets = batch.inputs, batch.targets
    turned = replace(inputs, observed=_turned(inputs.observed, matrices), initial=_turned(inputs.initial, matrices))
    if inputs.confounders is not None:
        turned.confounders = _turned_confounders(inputs.confounders, matrices)
    truth = replace(targets, position=_turned(targets.position, matrices), initial=_turned(targets.initial, matrices))
    return Batch(turned, truth)


def _turned(
    position: Float[Tensor, "batch *any 3"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch *any 3"]:
    xy = torch.einsum("bij,b...j->b...i", matrices, position[..., :2])
    return torch.cat([xy, position[..., 2:]], dim=-1)


def _turned_confounders(
    confounders: Float[Tensor, "batch slots features"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch slots features"]:
    turned = confounders.clone()
    for columns in HORIZONTAL:
        turned[..., columns] = torch.einsum("bij,bkj->bki", matrices, confounders[..., columns])
    return turned
