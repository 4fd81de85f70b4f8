"""Every training experiment, turned and mirrored at random as the symmetries of its scenario allow."""

import numpy as np
import torch
from torch import Tensor

from cophy.dataset.splits import Part
from cophy.scenario import Scenario
from cophy.types import HORIZONTAL, Batch


def symmetries_for(part: Part, scenario: Scenario) -> np.ndarray:
    """(S, 2, 2): the scenario's, or the identity alone where only seen configurations may be trained on (†).

    Turning an experiment turns its gravity: into that of a configuration that training shall not see.
    """
    return scenario.symmetries() if part.configurations is None else scenario.symmetries()[:1]


def augment(batch: Batch, symmetries: Tensor) -> Batch:
    """One of the symmetries (S, 2, 2) for each experiment: the same for AB, C, D and the confounders."""
    choice = torch.randint(len(symmetries), (len(batch.initial),), device=batch.initial.device)
    return transform(batch, symmetries[choice])


def transform(batch: Batch, matrices: Tensor) -> Batch:
    """The batch seen in other coordinates; matrices: (B, 2, 2) on (x, y), one per experiment."""
    confounders = batch.confounders.clone()
    for columns in HORIZONTAL:
        confounders[..., columns] = torch.einsum("bij,bkj->bki", matrices, batch.confounders[..., columns])
    return batch._replace(
        observed=_turned(batch.observed, matrices),
        initial=_turned(batch.initial, matrices),
        target=_turned(batch.target, matrices),
        confounders=confounders,
    )


def _turned(position: Tensor, matrices: Tensor) -> Tensor:
    """(B, ..., 3) metres -> the same with (x, y) transformed."""
    xy = torch.einsum("bij,b...j->b...i", matrices, position[..., :2])
    return torch.cat([xy, position[..., 2:]], dim=-1)
