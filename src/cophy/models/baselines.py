"""Baselines: copy C, copy B, the Interaction Network (IN) and the Neural Physics Engine (NPE)."""

from enum import Enum

import torch
from torch import nn

from cophy.models.layers import (
    Appearance,
    PairwiseMLP,
    check_at_least,
    check_positive,
    mlp,
    pack,
    parse_option,
    radius_graph,
    unpack,
)
from cophy.types import CONFOUNDERS, NUM_WITHOUT_POSE, Inputs, Prediction, true_confounders


class CopyC(nn.Module):
    """Copy C predicts that nothing moves: D is C and every object is stable (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the initial positions for every step."""
        position = inputs.initial[:, None].repeat(1, inputs.num_steps, 1, 1)
        return Prediction(position, stable_logit=torch.ones_like(position[..., 0]))


class CopyB(nn.Module):
    """Copy B predicts the observed outcome: the do-operation changes nothing (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the observed positions and stability, step for step."""
        seen = inputs.observed_presence[:, None]  # an object that a de-renderer missed in AB stays where it is in C
        position = torch.where(seen[..., None], inputs.observed[:, 1:], inputs.initial[:, None])
        stable = inputs.observed_stable | (inputs.presence[:, None] & ~seen)
        return Prediction(position, stable_logit=2 * stable.to(position.dtype) - 1)


class ConfounderInput(Enum):
    """True confounders that an interaction network can see: all of `CONFOUNDERS`, or only those that no image shows."""

    ground_truth = "ground_truth"
    without_pose = "without_pose"

    @property
    def width(self) -> int:
        """Number of features."""
        return len(CONFOUNDERS) if self is ConfounderInput.ground_truth else NUM_WITHOUT_POSE


class InteractionNetwork(nn.Module):
    """Feedforward baselines IN and NPE, which see C and never AB (paper, appendix).

    Both predict the next displacement of an object from its state and the effects of others on it:

        e^k = Σ_j f(o^k, o^j)        Δ^k = g(o^k, e^k)        position_{t+1}^k = position_t^k + Δ^k

    The state o is [position, displacement of the previous step]; the first displacement is zero. True confounders,
    object types and poses are appended where they are enabled. The Interaction Network (Battaglia et al., NIPS 2016)
    sums over all other objects. The Neural Physics Engine (Chang et al., ICLR 2017) sums over those within a radius.
    """

    def __init__(
        self,
        *,
        hidden_dim: int,
        edge_layers: int,
        node_layers: int,
        radius: float | None,
        confounders: ConfounderInput | str | None,
        object_type: bool = False,
        pose: bool = False,
    ) -> None:
        """Build f and g.

        Args:
            hidden_dim: Width of f and g.
            edge_layers: Linear layers of f, at least 2.
            node_layers: Linear layers of g.
            radius: Metres within which objects act on each other; None for all (Interaction Network).
            confounders: `ground_truth` makes the true confounders part of the state ("IN sup."), `without_pose` all but
                shape and orientation; None none.
            object_type: Whether the model sees the type of each object.
            pose: Whether the model sees the orientation of each object at t = 0.

        Raises:
            CophyError: An argument is out of its range.
        """
        super().__init__()
        check_at_least(1, hidden_dim=hidden_dim, node_layers=node_layers)
        check_at_least(2, edge_layers=edge_layers)
        check_positive(radius=radius)
        self.radius, self.num_confounders = radius, 0
        if confounders is not None:
            self.num_confounders = parse_option(ConfounderInput, "confounders", confounders).width
        self.appearance = Appearance(object_type, pose)
        state_dim = 6 + self.num_confounders + self.appearance.width
        self.f = PairwiseMLP(state_dim, hidden_dim, layers=edge_layers)
        self.g = mlp(state_dim + hidden_dim, hidden_dim, node_layers, output_dim=3)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        confounders = packed.initial[..., :0]
        if self.num_confounders:
            confounders = true_confounders(packed, self.num_confounders)
        constant = self.appearance.concatenate_to(confounders, packed)
        position, positions = packed.initial, []
        displacement = torch.zeros_like(position)
        for _ in range(inputs.num_steps):
            state = torch.cat([position, displacement, constant], dim=-1)
            graph = radius_graph(position, packed.presence, self.radius)
            effects = graph.sum_over_senders(self.f(state))
            displacement = self.g(torch.cat([state, effects], dim=-1))
            position = position + displacement
            positions.append(position)
        return unpack(Prediction(torch.stack(positions, dim=1)), slots, inputs.presence.shape[1])
