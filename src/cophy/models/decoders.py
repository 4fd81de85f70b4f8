"""From C and the confounders to D, gated by stability (paper Sec. 4.2).

There are two networks, one of stability and one of displacement. Here both get [o, u] of every object. The paper's
equation for the stability has that. Its equation for the displacement gives u of the neighbours but not of the object
itself. We take this for an oversight: an object would not know its own mass.

u is what stands for the confounders: the estimate U, the true ones, or nothing (width 0). Where a model declares object
types or poses, they follow.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.models.layers.graph import hear_mean_of_others
from cophy.models.options import Gating

MakeConvolution = Callable[[int], nn.Module]  # from the width of a node to a graph convolution, or what replaces it


def gate(stable_logit: Float[Tensor, "*any"], temperature: float) -> Float[Tensor, "*any"]:
    """σ((1 - s)/λ): the share of its displacement that an object makes (paper Sec. 4.2).

    s is a logit, not a probability. The gate is half open at s = 1, as the paper has it. Whether an object is said to be
    stable is another matter: that is decided at s = 0.
    """
    return torch.sigmoid((1 - stable_logit) / temperature)


class Rollout(nn.Module):
    """Step by step, each fed by the one before: o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t.

    The GRU over the steps is ψ in the paper's appendix. It takes one step at a time, because each needs the one before.
    """

    def __init__(
        self,
        make_convolution: MakeConvolution,
        *,
        input_dim: int,
        hidden_dim: int,
        gru_layers: int,
        temperature: float,
        gating: Gating,
    ) -> None:
        """Build the networks of stability and of displacement.

        Args:
            make_convolution: Builds a graph convolution; both networks have one.
            input_dim: Width of a node [o, u].
            hidden_dim: Width of all layers.
            gru_layers: GRU cells on top of each other.
            temperature: λ of the gate.
            gating: Whether stability is decided at every step, or once from C.
        """
        super().__init__()
        self.temperature, self.gating = temperature, gating
        self.stability = make_convolution(input_dim)
        self.to_stable_logit = nn.Linear(hidden_dim, 1)
        self.dynamics = make_convolution(input_dim)
        self.cells = nn.ModuleList(nn.GRUCell(hidden_dim, hidden_dim) for _ in range(gru_layers))
        self.to_displacement = nn.Linear(hidden_dim, 3)

    def forward(
        self,
        initial: Float[Tensor, "batch slots 3"],
        u: Float[Tensor, "batch slots u"],
        presence: Bool[Tensor, "batch slots"],
        num_steps: int,
    ) -> tuple[Float[Tensor, "batch steps slots 3"], Float[Tensor, "batch steps_or_one slots"]]:
        """Roll D out from C.

        Args:
            initial: Positions in C, metres.
            u: What is known of every object beside its position.
            presence: Which slots hold an object.
            num_steps: Frames of D to predict.

        Returns:
            Positions, and stability logits.
        """
        graph = hear_mean_of_others(presence, initial.dtype)
        position, positions, logits = initial, [], []
        hidden: list[Tensor | None] = [None] * len(self.cells)  # None is zero
        for step in range(num_steps):
            nodes = torch.cat([position, u], dim=-1)
            if step == 0 or self.gating is Gating.per_step:
                logits.append(self.to_stable_logit(self.stability(nodes, graph)))
            state = self.dynamics(nodes, graph).flatten(0, 1)
            for layer, cell in enumerate(self.cells):
                state = cell(state, hidden[layer])
                hidden[layer] = state
            displacement = self.to_displacement(state).view_as(position)
            position = position + gate(logits[-1], self.temperature) * displacement
            positions.append(position)
        return torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1)


class SingleStep(nn.Module):
    """All steps at once, without recurrence (paper Table 6 left): o_t = o_0 + σ((1 - s_t)/λ) Δ_t.

    Here Δ_t is the way from C, not from the step before.
    """

    def __init__(
        self, make_convolution: MakeConvolution, *, input_dim: int, hidden_dim: int, temperature: float, num_steps: int
    ) -> None:
        """Build the networks of stability and of displacement.

        Args:
            make_convolution: Builds a graph convolution; both networks have one.
            input_dim: Width of a node [o, u].
            hidden_dim: Width of all layers.
            temperature: λ of the gate.
            num_steps: Frames of D, the same for every batch.
        """
        super().__init__()
        self.temperature = temperature
        self.stability = make_convolution(input_dim)
        self.to_stable_logits = nn.Linear(hidden_dim, num_steps)
        self.dynamics = make_convolution(input_dim)
        self.to_displacements = nn.Linear(hidden_dim, 3 * num_steps)

    def forward(
        self,
        initial: Float[Tensor, "batch slots 3"],
        u: Float[Tensor, "batch slots u"],
        presence: Bool[Tensor, "batch slots"],
        num_steps: int,
    ) -> tuple[Float[Tensor, "batch steps slots 3"], Float[Tensor, "batch steps slots"]]:
        """Predict D; arguments and results as of `Rollout.forward`."""
        graph, nodes = hear_mean_of_others(presence, initial.dtype), torch.cat([initial, u], dim=-1)
        logits = self.to_stable_logits(self.stability(nodes, graph))  # batch slots steps
        displacement = self.to_displacements(self.dynamics(nodes, graph)).unflatten(-1, (num_steps, 3))
        position = initial[:, :, None] + gate(logits, self.temperature)[..., None] * displacement
        return position.transpose(1, 2), logits.transpose(1, 2)
