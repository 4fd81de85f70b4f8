"""From C and the confounders to D, gated by stability (paper Sec. 4.2).

Nodes are [o, u] for the object itself too, as in the paper's own stability network (its equation for the displacement
gives the neighbours u but not the object). Inside, all objects of a batch are one axis, K·B, slots first.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from cophy.models.affine import affine
from cophy.models.interactions import Interactions
from cophy.models.options import Gating
from cophy.models.recurrence import layers
from cophy.types import Batch

Build = Callable[[int], Interactions]  # interactions of nodes of a given width


def gate(stable_logit: Tensor, temperature: float) -> Tensor:
    """σ((1 - s)/λ): the share of its displacement that an object of stability s makes (paper Sec. 4.2)."""
    return torch.sigmoid((1 - stable_logit) / temperature)


class Rollout(nn.Module):
    """Step by step, each fed by the one before: o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t."""

    def __init__(
        self,
        interactions: Build,
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
        presence, constant, position = _slots_first(batch, confounders)
        first, *others = layers(self.gru)
        stability, dynamics = (self.stability, affine(self.stable_logit)), (self.dynamics, first.input)
        chosen = [stability, dynamics] if self.gating is Gating.per_step else [dynamics]
        interact = self.dynamics.together(chosen, presence, constant)
        hidden = [position.new_zeros(len(position), self.hidden_dim) for _ in self.gru]
        positions, logits = [], []
        if self.gating is Gating.static:
            logits += self.stability.together([stability], presence, constant)(position)
        for _ in range(horizon):
            *logit, inputs = interact(position)
            logits += logit
            hidden[0] = first(inputs, hidden[0])
            for number, layer in enumerate(others, start=1):
                hidden[number] = layer(layer.input(hidden[number - 1]), hidden[number])
            position = position + gate(logits[-1], self.temperature) * self.displacement(hidden[-1])
            positions.append(position)
        return _batch_first(torch.stack(positions), presence), _batch_first(torch.stack(logits), presence).squeeze(-1)


class SingleStep(nn.Module):
    """All steps at once, without recurrence (paper Table 6 left): o_t = o_0 + σ((1 - s_t)/λ) Δ_t."""

    def __init__(
        self, interactions: Build, *, input_dim: int, hidden_dim: int, temperature: float, horizon: int
    ) -> None:
        super().__init__()
        self.temperature = temperature
        self.stability = interactions(input_dim)
        self.stable_logit = nn.Linear(hidden_dim, horizon)
        self.dynamics = interactions(input_dim)
        self.displacement = nn.Linear(hidden_dim, 3 * horizon)

    def forward(self, batch: Batch, confounders: Tensor, horizon: int) -> tuple[Tensor, Tensor]:
        """Positions (B, horizon, K, 3) and stability logits (B, horizon, K); `horizon` is the one it was built for."""
        presence, constant, position = _slots_first(batch, confounders)
        parts = [(self.stability, affine(self.stable_logit)), (self.dynamics, affine(self.displacement))]
        logits, displacement = self.dynamics.together(parts, presence, constant)(position)
        moved = gate(logits, self.temperature)[..., None] * displacement.view(-1, horizon, 3)
        positions = (position[:, None] + moved).transpose(0, 1)
        return _batch_first(positions, presence), _batch_first(logits.t()[..., None], presence).squeeze(-1)


def _slots_first(batch: Batch, confounders: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Presence (K, B), confounders (K·B, U) and positions in C (K·B, 3)."""
    constant, position = (tensor.transpose(0, 1).flatten(0, 1) for tensor in (confounders, batch.initial))
    return batch.presence.t(), constant, position


def _batch_first(values: Tensor, presence: Tensor) -> Tensor:
    """(T, K·B, F) -> (B, T, K, F)."""
    return values.view(len(values), *presence.shape, -1).permute(2, 0, 1, 3)
