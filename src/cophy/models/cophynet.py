"""CoPhyNet (paper Sec. 4): predict D from C and what AB tells about the confounders.

Switches of the models, as configuration spells them.
Unsupervised estimation of the confounders from AB (paper Sec. 4.1).
From C and the confounders to D, gated by stability (paper Sec. 4.2).

There are two networks, one of stability and one of displacement. Here both get [o, u] of every object. The paper's
equation for the stability has that. Its equation for the displacement gives u of the neighbours but not of the object
itself. We take this for an oversight: an object would not know its own mass.

u is what stands for the confounders: the estimate U, the true ones, or nothing (width 0). Where a model declares object
types or poses, they follow.
"""

from collections.abc import Callable
from enum import Enum

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.models.layers import Appearance, GraphConvolution, SlotMLP, hear_mean_of_others, pack, unpack
from cophy.types import CONFOUNDERS, Inputs, Prediction, true_confounders


class ConfounderSource(Enum):
    """Where CoPhyNet's confounders come from: AB, the ground truth, or nowhere (a feedforward model)."""

    estimated = "estimated"
    ground_truth = "ground_truth"
    none = "none"


class ConfounderInput(Enum):
    """What a model that never sees AB may be given besides C (or null: nothing)."""

    ground_truth = "ground_truth"


class Gating(Enum):
    """When stability is decided: at every step, or once per sequence from C and U (paper Table 6 left)."""

    per_step = "per_step"
    static = "static"


class Interaction(Enum):
    """How objects hear of each other: graph convolution, or an MLP over the concatenated slots (paper Table 6 left)."""

    graph = "graph"
    mlp = "mlp"


class Decoding(Enum):
    """How D is predicted: step by step, or all of it at once (paper Table 6 left)."""

    autoregressive = "autoregressive"
    single_step = "single_step"


class Readout(Enum):
    """How a de-renderer reads positions off its maps: by where an object is and how it looks there, or linearly (paper)."""

    attention = "attention"
    linear = "linear"


class ConfounderEstimator(nn.Module):
    """Graph convolution per frame of AB, then a GRU per object over time (φ in the paper's appendix).

    The estimate u^k of object k is the GRU's hidden state after the last frame, of its top layer. All objects share
    the GRU.
    """

    def __init__(self, convolution: nn.Module, *, hidden_dim: int, gru_layers: int) -> None:
        """Build the estimator.

        Args:
            convolution: From nodes (what is seen of objects in one frame) and a graph to features of width `hidden_dim`.
            hidden_dim: Width of the GRU, and of U.
            gru_layers: Layers of the GRU.
        """
        super().__init__()
        self.convolution = convolution
        self.gru = nn.GRU(hidden_dim, hidden_dim, gru_layers)

    def forward(
        self, observed: Float[Tensor, "batch time slots node"], presence: Bool[Tensor, "batch slots"]
    ) -> Float[Tensor, "batch slots hidden"]:
        """From what is seen in AB, positions first of all, to U."""
        batch, time, slots, _ = observed.shape
        graph = hear_mean_of_others(presence.repeat_interleave(time, dim=0), observed.dtype)
        features = self.convolution(observed.flatten(0, 1), graph)  # all frames at once
        over_time = features.view(batch, time, slots, -1).transpose(0, 1).flatten(1, 2)  # time, every object, features
        _, final = self.gru(over_time)
        top_layer = final[-1]
        return top_layer.view(batch, slots, -1)


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


class CoPhyNet(nn.Module):
    """The counterfactual predictor and its ablations.

    With graph convolutions, CoPhyNet takes any number of objects in any order. The ablation `mlp` is tied to the slots,
    the ablation `single_step` to the number of frames.

    Attributes:
        estimate_dim: Width of U; 0 where none is estimated.
    """

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
        interaction: str,
        decoding: str,
        object_type: bool = False,
        pose: bool = False,
        num_frames: int | None = None,
        slots: list[str] | None = None,
    ) -> None:
        """Build the estimator and the decoder.

        Args:
            hidden_dim: Width of f, g, both GRUs and U (paper, appendix).
            gru_layers: Layers of both GRUs.
            edge_layers: Linear layers of f, at least 2.
            node_layers: Linear layers of g.
            temperature: λ of the gate.
            confounders: Where they come from: a value of `ConfounderSource`.
            gating: When stability is decided: a value of `Gating`.
            interaction: How objects hear of each other: a value of `Interaction`.
            decoding: How D is predicted: a value of `Decoding`.
            object_type: Whether it sees what each object is.
            pose: Whether it sees how each object is turned at t = 0.
            num_frames: T, needed where decoding is `single_step`.
            slots: Names of the colour slots, needed where interaction is `mlp`.
        """
        super().__init__()
        self.source, self.interaction = ConfounderSource(confounders), Interaction(interaction)
        self.appearance = Appearance(object_type, pose)
        seen_dim = 3 + self.appearance.width

        def make_convolution(input_dim: int) -> nn.Module:
            if self.interaction is Interaction.mlp:
                assert slots is not None
                return SlotMLP(input_dim, hidden_dim, layers=edge_layers, num_slots=len(slots))
            return GraphConvolution(input_dim, hidden_dim, edge_layers=edge_layers, node_layers=node_layers)

        if self.source is ConfounderSource.estimated:
            self.estimator = ConfounderEstimator(
                make_convolution(seen_dim), hidden_dim=hidden_dim, gru_layers=gru_layers
            )
        self.estimate_dim = hidden_dim if self.source is ConfounderSource.estimated else 0
        given_dim = len(CONFOUNDERS) if self.source is ConfounderSource.ground_truth else 0
        sizes = {"input_dim": seen_dim + self.estimate_dim + given_dim, "hidden_dim": hidden_dim}
        self.decoder: nn.Module
        if Decoding(decoding) is Decoding.single_step:
            assert num_frames is not None
            self.decoder = SingleStep(make_convolution, temperature=temperature, num_steps=num_frames - 1, **sizes)
        else:
            self.decoder = Rollout(
                make_convolution, gru_layers=gru_layers, temperature=temperature, gating=Gating(gating), **sizes
            )

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D, one step per frame of AB after the first."""
        if self.interaction is Interaction.mlp:
            # it has weights of its own for every slot, so slots must stay where they are
            return self._predict(inputs)
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        u = self._confounders(inputs)
        known = self.appearance.beside(u, inputs)
        position, stable_logit = self.decoder(inputs.initial, known, inputs.presence, inputs.num_steps)
        return Prediction(position, stable_logit, u if self.source is ConfounderSource.estimated else None)

    def _confounders(self, inputs: Inputs) -> Float[Tensor, "batch slots u"]:
        if self.source is ConfounderSource.estimated:
            return self.estimator(self.appearance.beside(inputs.observed, inputs), inputs.observed_presence)
        if self.source is ConfounderSource.ground_truth:
            return true_confounders(inputs)
        return inputs.initial[..., :0]  # nothing: width 0
