"""From C and the confounders to D, gated by stability (paper Sec. 4.2).

Nodes are [o, u] for the object itself too, as in the paper's own stability network (its equation for the displacement
gives the neighbours u but not the object).
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from cophy.models.graph import Graph, fully_connected
from cophy.models.options import Gating
from cophy.types import Batch

Interactions = Callable[[int], nn.Module]  # builds, for an input width, a module from nodes and graph to features


def gate(stable_logit: Tensor, temperature: float) -> Tensor:
    """σ((1 - s)/λ): the share of its displacement that an object of stability s makes (paper Sec. 4.2)."""
    return torch.sigmoid((1 - stable_logit) / temperature)


class Rollout(nn.Module):
    """Step by step, each fed by the one before: o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t."""

    def __init__(
        self,
        interactions: Interactions,
        *,
        input_dim: int,
        hidden_dim: int,
        gru_layers: int,
        temperature: float,
        gating: Gating,
    ) -> None:
        super().__init__()
        self.temperature, self.hidden_dim, self.gating = temperature, hidden_dim, gating
        self.stability = interactions(input_dim)
        self.stable_logit = nn.Linear(hidden_dim, 1)
        self.dynamics = interactions(input_dim)
        self.gru = nn.ModuleList(nn.GRUCell(hidden_dim, hidden_dim) for _ in range(gru_layers))
        self.displacement = nn.Linear(hidden_dim, 3)

    def forward(self, batch: Batch, confounders: Tensor, horizon: int) -> tuple[Tensor, Tensor]:
        """Positions (B, horizon, K, 3) and stability logits (B, horizon or 1, K)."""
        graph = fully_connected(batch.presence)
        position = batch.initial
        hidden = [position.new_zeros(*position.shape[:2], self.hidden_dim) for _ in self.gru]
        positions, logits = [], []
        for step in range(horizon):
            nodes = torch.cat([position, confounders], dim=-1)
            if step == 0 or self.gating is Gating.per_step:
                logits.append(self.stable_logit(self.stability(nodes, graph)))
            displacement, hidden = self.step(nodes, graph, hidden)
            position = position + gate(logits[-1], self.temperature) * displacement
            positions.append(position)
        return torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1)

    def step(self, nodes: Tensor, graph: Graph, hidden: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Displacement Δ_t (B, K, 3) before gating, and the next hidden states."""
        features, states = self.dynamics(nodes, graph), []
        for cell, state in zip(self.gru, hidden, strict=True):
            features = cell(features.flatten(0, 1), state.flatten(0, 1)).view_as(state)
            states.append(features)
        return self.displacement(features), states


class SingleStep(nn.Module):
    """All steps at once, without recurrence (paper Table 6 left): o_t = o_0 + σ((1 - s_t)/λ) Δ_t."""

    def __init__(
        self, interactions: Interactions, *, input_dim: int, hidden_dim: int, temperature: float, horizon: int
    ) -> None:
        super().__init__()
        self.temperature = temperature
        self.stability = interactions(input_dim)
        self.stable_logit = nn.Linear(hidden_dim, horizon)
        self.dynamics = interactions(input_dim)
        self.displacement = nn.Linear(hidden_dim, 3 * horizon)

    def forward(self, batch: Batch, confounders: Tensor, horizon: int) -> tuple[Tensor, Tensor]:
        """Positions (B, horizon, K, 3) and stability logits (B, horizon, K); `horizon` is the one it was built for."""
        graph = fully_connected(batch.presence)
        nodes = torch.cat([batch.initial, confounders], dim=-1)
        logits = self.stable_logit(self.stability(nodes, graph))
        displacement = self.displacement(self.dynamics(nodes, graph)).unflatten(-1, (horizon, 3))
        position = batch.initial[:, :, None] + gate(logits, self.temperature)[..., None] * displacement
        return position.transpose(1, 2), logits.transpose(1, 2)
