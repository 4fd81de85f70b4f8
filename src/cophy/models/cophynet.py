"""CoPhyNet (paper Sec. 4): predict D from C and what AB tells about the confounders.

    observed AB --GCN per frame, GRU over time--> confounders U --+
                                                                  |
    initial C --> [o_t, u] --GCN--> stability s_t ----------------+--> o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t
                      |                                           |
                      +------GCN, GRU over time, linear--> Δ_t ---+

Differs from the paper: the decoder's nodes are [o, u] for the object itself too, as in the paper's own stability
network (its equation gives the neighbours u but not the object).
"""

import torch
from torch import Tensor, nn

from cophy.models.confounder_estimator import ConfounderEstimator
from cophy.models.graph import Graph, GraphConvolution, fully_connected
from cophy.models.options import ConfounderSource, Gating
from cophy.models.packing import pack, unpack
from cophy.types import CONFOUNDERS, Batch, Prediction


class CoPhyNet(nn.Module):
    """The counterfactual predictor. K-agnostic and equivariant to the order of objects."""

    def __init__(
        self,
        *,
        hidden_dim: int,
        gru_layers: int,
        edge_layers: int,
        node_layers: int,
        temperature: float,
        confounders: str,
        gating: str,
    ) -> None:
        super().__init__()
        self.source, self.gating = ConfounderSource(confounders), Gating(gating)
        self.temperature, self.hidden_dim = temperature, hidden_dim
        layers = {"edge_layers": edge_layers, "node_layers": node_layers}
        if self.source is ConfounderSource.estimated:
            self.estimator = ConfounderEstimator(hidden_dim=hidden_dim, gru_layers=gru_layers, **layers)
        confounder_dim = {"estimated": hidden_dim, "ground_truth": len(CONFOUNDERS), "none": 0}[self.source.value]
        self.stability = GraphConvolution(3 + confounder_dim, hidden_dim, **layers)
        self.stable_logit = nn.Linear(hidden_dim, 1)
        self.dynamics = GraphConvolution(3 + confounder_dim, hidden_dim, **layers)
        self.gru = nn.ModuleList(nn.GRUCell(hidden_dim, hidden_dim) for _ in range(gru_layers))
        self.displacement = nn.Linear(hidden_dim, 3)

    def forward(self, batch: Batch) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(batch)
        confounders = self.confounders(packed)
        position, stable_logit = self.rollout(packed, confounders, horizon=batch.observed.shape[1] - 1)
        estimate = confounders if self.source is ConfounderSource.estimated else None
        return unpack(Prediction(position, stable_logit, estimate), slots, batch.initial.shape[1])

    def confounders(self, batch: Batch) -> Tensor:
        """(B, K, U): estimated from AB, given, or of width 0."""
        if self.source is ConfounderSource.estimated:
            return self.estimator(batch.observed, batch.observed_presence)
        return batch.confounders if self.source is ConfounderSource.ground_truth else batch.confounders[..., :0]

    def rollout(self, batch: Batch, confounders: Tensor, *, horizon: int) -> tuple[Tensor, Tensor]:
        """Positions (B, horizon, K, 3) and stability logits (B, horizon or 1, K), each step fed by the one before."""
        graph = fully_connected(batch.presence)
        position = batch.initial
        hidden = [position.new_zeros(*position.shape[:2], self.hidden_dim) for _ in self.gru]
        positions, logits = [], []
        for step in range(horizon):
            nodes = torch.cat([position, confounders], dim=-1)
            if step == 0 or self.gating is Gating.per_step:
                logits.append(self.stable_logit(self.stability(nodes, graph)))
            displacement, hidden = self.step(nodes, graph, hidden)
            position = position + torch.sigmoid((1 - logits[-1]) / self.temperature) * displacement
            positions.append(position)
        return torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1)

    def step(self, nodes: Tensor, graph: Graph, hidden: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Displacement Δ_t (B, K, 3) before gating, and the next hidden states."""
        features, states = self.dynamics(nodes, graph), []
        for cell, state in zip(self.gru, hidden, strict=True):
            features = cell(features.flatten(0, 1), state.flatten(0, 1)).view_as(state)
            states.append(features)
        return self.displacement(features), states
