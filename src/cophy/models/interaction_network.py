"""Feedforward baselines: Interaction Network (Battaglia et al., NIPS 2016), Neural Physics Engine (Chang et al., ICLR 2017).

Both predict an object's next velocity from its state and the sum of the effects of others on it:

    e^k = Σ_j f(o^k, o^j)        Δ^k = g(o^k, e^k)        position_{t+1}^k = position_t^k + Δ^k

with states o = [position, displacement of the step before], zero before the first. IN sums over all other objects,
NPE over those within a radius. They see C, never AB (paper, appendix); the true confounders may be part of the state.
"""

import torch
from torch import nn

from cophy.models.graph import Messages, neighbours
from cophy.models.mlp import mlp
from cophy.models.options import ConfounderInput
from cophy.models.packing import pack, unpack
from cophy.types import CONFOUNDERS, Batch, Prediction


class InteractionNetwork(nn.Module):
    """Autoregressive from C. radius: None for IN, in metres for NPE; confounders: None, or "ground_truth" (IN sup.)."""

    def __init__(
        self, *, hidden_dim: int, edge_layers: int, node_layers: int, radius: float | None, confounders: str | None
    ) -> None:
        super().__init__()
        self.radius = radius
        self.confounders = None if confounders is None else ConfounderInput(confounders)
        state_dim = 6 + (len(CONFOUNDERS) if self.confounders else 0)
        self.effects = Messages(state_dim, hidden_dim, layers=edge_layers)
        self.dynamics = mlp(state_dim + hidden_dim, hidden_dim, node_layers, output_dim=3)

    def forward(self, batch: Batch) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(batch)
        confounders = packed.confounders if self.confounders else packed.confounders[..., :0]
        position, positions = packed.initial, []
        displacement = torch.zeros_like(position)
        for _ in range(batch.observed.shape[1] - 1):
            state = torch.cat([position, displacement, confounders], dim=-1)
            effects = self.effects(state, neighbours(packed.presence, position, self.radius))
            displacement = self.dynamics(torch.cat([state, effects], dim=-1))
            position = position + displacement
            positions.append(position)
        return unpack(Prediction(torch.stack(positions, dim=1)), slots, batch.initial.shape[1])
