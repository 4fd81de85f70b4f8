"""What CoPhyNet is held against: copies, the Interaction Network and the Neural Physics Engine."""

import torch
from torch import nn

from cophy.models.cophynet import ConfounderInput
from cophy.models.layers import Appearance, PairwiseMLP, hear_sum_of_near, mlp, pack, unpack
from cophy.types import CONFOUNDERS, Inputs, Prediction, true_confounders


class CopyC(nn.Module):
    """D is C: nothing moves, every object is stable (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the initial positions for every step."""
        position = inputs.initial[:, None].repeat(1, inputs.num_steps, 1, 1)
        return Prediction(position, stable_logit=torch.ones_like(position[..., 0]))


class CopyB(nn.Module):
    """D is B: the do-operation changed nothing (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the observed positions and stability, step for step."""
        seen = inputs.observed_presence[:, None]  # what a de-renderer missed in AB stays where it is in C
        position = torch.where(seen[..., None], inputs.observed[:, 1:], inputs.initial[:, None])
        stable = inputs.observed_stable | (inputs.presence[:, None] & ~seen)
        return Prediction(position, stable_logit=2 * stable.to(position.dtype) - 1)


class InteractionNetwork(nn.Module):
    """Feedforward baselines, which see C and never AB (paper, appendix).

    Both predict an object's next displacement from its state and the effects of others on it:

        e^k = Σ_j f(o^k, o^j)        Δ^k = g(o^k, e^k)        position_{t+1}^k = position_t^k + Δ^k

    The state o is [position, displacement of the step before]; that is zero before the first step. True confounders,
    object types and poses follow where they are declared. The Interaction Network (Battaglia et al., NIPS 2016) sums
    over all other objects. The Neural Physics Engine (Chang et al., ICLR 2017) sums over those within a radius.
    """

    def __init__(
        self,
        *,
        hidden_dim: int,
        edge_layers: int,
        node_layers: int,
        radius: float | None,
        confounders: str | None,
        object_type: bool = False,
        pose: bool = False,
    ) -> None:
        """Build f and g.

        Args:
            hidden_dim: Width of f and g.
            edge_layers: Linear layers of f, at least 2.
            node_layers: Linear layers of g.
            radius: Metres within which objects act on each other; None for all (Interaction Network).
            confounders: `ground_truth` makes the true confounders part of the state ("IN sup."); None does not.
            object_type: Whether it sees what each object is.
            pose: Whether it sees how each object is turned at t = 0.
        """
        super().__init__()
        self.radius = radius
        self.confounders = None if confounders is None else ConfounderInput(confounders)
        self.appearance = Appearance(object_type, pose)
        state_dim = 6 + (len(CONFOUNDERS) if self.confounders else 0) + self.appearance.width
        self.f = PairwiseMLP(state_dim, hidden_dim, layers=edge_layers)
        self.g = mlp(state_dim + hidden_dim, hidden_dim, node_layers, output_dim=3)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        confounders = true_confounders(packed) if self.confounders else packed.initial[..., :0]
        known = self.appearance.beside(confounders, packed)
        position, positions = packed.initial, []
        displacement = torch.zeros_like(position)
        for _ in range(inputs.num_steps):
            state = torch.cat([position, displacement, known], dim=-1)
            graph = hear_sum_of_near(self.radius, position, packed.presence)
            effects = graph.sum_over_senders(self.f(state))
            displacement = self.g(torch.cat([state, effects], dim=-1))
            position = position + displacement
            positions.append(position)
        return unpack(Prediction(torch.stack(positions, dim=1)), slots, inputs.presence.shape[1])
