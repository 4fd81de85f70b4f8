"""CoPhyNet (paper Sec. 4): predict D from C and from what AB shows about the confounders.

    observed AB --GCN per frame, GRU over time--> u
                                                  |
    initial C = o_0 ----------------------> [o_t, u] --GCN--> stability s_t --------------------+
                                             ^    |                                             |
                                             |    +--GCN, GRU over time, linear--> Δ_t --> o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t
                                             |                                                  |
                                             +------------------- next step --------------------+

u is the estimate U, the true confounders, or nothing (width 0). Object types and poses, where enabled, are appended to every
position of AB and to u. Both networks of the decoder get [o, u] of every object. The paper's equation for the stability has
that; its equation for the displacement has u of the neighbours only. We take this for an oversight, because an object would
not know its own mass.
"""

from collections.abc import Callable
from enum import Enum

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.models.baselines import ConfounderInput
from cophy.models.frames import check_frame, predict_in_frame
from cophy.models.layers import (
    Appearance,
    GraphConvolution,
    SlotMLP,
    check_at_least,
    check_layers,
    check_positive,
    mean_graph,
    pack,
    parse_option,
    unpack,
)
from cophy.types import Inputs, Prediction, true_confounders


class ConfounderSource(Enum):
    """Source of the confounders: estimated from AB, ground truth with or without pose, or none (a feedforward model)."""

    estimated = "estimated"
    ground_truth = "ground_truth"
    without_pose = "without_pose"
    none = "none"


class Gating(Enum):
    """When stability is predicted: at every step, or once per sequence from C and U (paper Table 6 left)."""

    per_step = "per_step"
    static = "static"


class Interaction(Enum):
    """How objects interact: graph convolution, or an MLP over the concatenated slots (paper Table 6 left)."""

    graph = "graph"
    mlp = "mlp"


class Decoding(Enum):
    """How D is predicted: step by step, or all steps at once (paper Table 6 left)."""

    autoregressive = "autoregressive"
    single_step = "single_step"


class ConfounderEstimator(nn.Module):
    """Unsupervised estimation of the confounders from AB (paper Sec. 4.1; φ in the appendix).

    A graph convolution per frame is followed by a GRU over time that all objects share. The estimate u^k of object k is
    the hidden state of the GRU's top layer after the last frame.

    Args:
        convolution: Maps nodes (objects in one frame) and a graph to features of width `hidden_dim`.
        hidden_dim: Width of the GRU, and of U.
        gru_layers: Layers of the GRU.
    """

    def __init__(self, convolution: nn.Module, *, hidden_dim: int, gru_layers: int) -> None:
        super().__init__()
        self.convolution = convolution
        self.gru = nn.GRU(hidden_dim, hidden_dim, gru_layers)

    def forward(
        self, observed: Float[Tensor, "batch time slots node"], presence: Bool[Tensor, "batch slots"]
    ) -> Float[Tensor, "batch slots hidden"]:
        """Return U, given the positions in AB (and object types and poses, where enabled)."""
        batch, time, slots, _ = observed.shape
        graph = mean_graph(presence.repeat_interleave(time, dim=0), observed.dtype)
        features = self.convolution(observed.flatten(0, 1), graph)  # all frames at once
        over_time = features.view(batch, time, slots, -1).transpose(0, 1).flatten(1, 2)  # time, object, features
        _, final = self.gru(over_time)
        return final[-1].view(batch, slots, -1)


MakeConvolution = Callable[[int], nn.Module]  # width of a node -> a graph convolution, or its replacement `SlotMLP`


def gate(stable_logit: Float[Tensor, "*any"], temperature: float) -> Float[Tensor, "*any"]:
    """Return the gate σ((1 - s)/λ), by which displacements are multiplied (paper Sec. 4.2).

    s is a logit, not a probability. As in the paper, the gate is half open at s = 1. The predicted class (stable or not)
    uses the threshold s = 0 instead.
    """
    return torch.sigmoid((1 - stable_logit) / temperature)


class Rollout(nn.Module):
    """Autoregressive decoder (paper Sec. 4.2): o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t.

    The GRU over the steps is ψ in the paper's appendix. It runs one step at a time, because each step depends on the
    previous one.

    Args:
        make_convolution: Builds a graph convolution for nodes of a given width.
        input_dim: Width of a node [o, u].
        hidden_dim: Width of all layers.
        gru_layers: Stacked GRU cells.
        temperature: λ of the gate.
        gating: When stability is predicted.
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
            u: Constant features of every object.
            presence: Which slots hold an object.
            num_steps: Frames of D to predict.

        Returns:
            Positions, and stability logits.
        """
        graph = mean_graph(presence, initial.dtype)
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
    """Decoder of all steps at once, without recurrence (paper Table 6 left): o_t = o_0 + σ((1 - s_t)/λ) Δ_t.

    Here Δ_t is the displacement from C, not from the previous step.

    Args:
        make_convolution: Builds a graph convolution for nodes of a given width.
        input_dim: Width of a node [o, u].
        hidden_dim: Width of all layers.
        temperature: λ of the gate.
        num_steps: Frames of D, the same for every batch.
    """

    def __init__(
        self, make_convolution: MakeConvolution, *, input_dim: int, hidden_dim: int, temperature: float, num_steps: int
    ) -> None:
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
        """Predict D, with arguments and results as in `Rollout.forward`."""
        graph, nodes = mean_graph(presence, initial.dtype), torch.cat([initial, u], dim=-1)
        logits = self.to_stable_logits(self.stability(nodes, graph))  # batch slots steps
        displacement = self.to_displacements(self.dynamics(nodes, graph)).unflatten(-1, (num_steps, 3))
        position = initial[:, :, None] + gate(logits, self.temperature)[..., None] * displacement
        return position.transpose(1, 2), logits.transpose(1, 2)


class CoPhyNet(nn.Module):
    """The counterfactual predictor and its ablations.

    With graph convolutions, CoPhyNet takes any number of objects in any order. The ablation `mlp` needs a fixed number
    and order of slots, the ablation `single_step` a fixed number of frames.

    Args:
        hidden_dim: Width of f, g, both GRUs and U (paper, appendix).
        gru_layers: Layers of both GRUs.
        edge_layers: Linear layers of f, at least 2.
        node_layers: Linear layers of g, at least 2.
        temperature: λ of the gate.
        confounders: Source of the confounders: a value of `ConfounderSource`.
        gating: When stability is predicted: a value of `Gating`.
        interaction: How objects interact: a value of `Interaction`.
        decoding: How D is predicted: a value of `Decoding`.
        object_type: Whether the model sees the type of each object.
        pose: Whether the model sees the orientation of each object at t = 0.
        num_frames: T, needed for `single_step`.
        slots: Names of the colour slots, needed for `mlp`.
        canonical_frame: Name of the scenario whose symmetries are removed from the positions (`cophy.models.frames`);
            None for positions as they are.

    Raises:
        CophyError: An argument is out of its range, or missing.

    Attributes:
        estimate_dim: Width of U; 0 if nothing is estimated.
    """

    def __init__(
        self,
        *,
        hidden_dim: int,
        gru_layers: int,
        edge_layers: int,
        node_layers: int,
        temperature: float,
        confounders: ConfounderSource | str,
        gating: Gating | str,
        interaction: Interaction | str,
        decoding: Decoding | str,
        object_type: bool = False,
        pose: bool = False,
        num_frames: int | None = None,
        slots: list[str] | None = None,
        canonical_frame: str | None = None,
    ) -> None:
        super().__init__()
        check_at_least(1, hidden_dim=hidden_dim)
        check_layers(1, gru_layers=gru_layers)
        check_layers(2, edge_layers=edge_layers, node_layers=node_layers)
        check_positive(temperature=temperature)
        self.source = parse_option(ConfounderSource, "confounders", confounders)
        self.interaction = parse_option(Interaction, "interaction", interaction)
        gating_option, decoding_option = (
            parse_option(Gating, "gating", gating),
            parse_option(Decoding, "decoding", decoding),
        )
        self.appearance = Appearance(object_type, pose)
        position_dim = 3 + self.appearance.width
        knows_confounders = self.source in (ConfounderSource.ground_truth, ConfounderSource.without_pose)
        check_frame(canonical_frame)
        if decoding_option is Decoding.single_step and gating_option is not Gating.per_step:
            raise CophyError(
                "model.gating has no effect with model.decoding=single_step, which decides once: leave it out"
            )
        self.canonical_frame = canonical_frame

        def make_convolution(input_dim: int) -> nn.Module:
            if self.interaction is Interaction.graph:
                return GraphConvolution(input_dim, hidden_dim, edge_layers=edge_layers, node_layers=node_layers)
            if not slots:
                raise CophyError("model.interaction=mlp needs model.slots, see conf/ablation/mlp.yaml")
            return SlotMLP(input_dim, hidden_dim, layers=edge_layers, num_slots=len(slots))

        self.estimate_dim = 0
        if self.source is ConfounderSource.estimated:
            convolution = make_convolution(position_dim)
            self.estimator = ConfounderEstimator(convolution, hidden_dim=hidden_dim, gru_layers=gru_layers)
            self.estimate_dim = hidden_dim
        self.num_confounders = 0
        if knows_confounders:
            self.num_confounders = ConfounderInput(self.source.value).width
        node_dim = position_dim + self.estimate_dim + self.num_confounders
        self.decoder: nn.Module
        if decoding_option is Decoding.single_step:
            if num_frames is None:
                raise CophyError(
                    "model.decoding=single_step needs model.num_frames, see conf/ablation/single_step.yaml"
                )
            self.decoder = SingleStep(
                make_convolution,
                input_dim=node_dim,
                hidden_dim=hidden_dim,
                temperature=temperature,
                num_steps=num_frames - 1,
            )
        else:
            self.decoder = Rollout(
                make_convolution,
                input_dim=node_dim,
                hidden_dim=hidden_dim,
                gru_layers=gru_layers,
                temperature=temperature,
                gating=gating_option,
            )

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D, one step per frame of AB after the first."""
        return predict_in_frame(self._predict_with_slots, inputs, self.canonical_frame)

    def _predict_with_slots(self, inputs: Inputs) -> Prediction:
        if self.interaction is Interaction.mlp:  # it has separate weights for every slot, so slots must stay in place
            return self._predict(inputs)
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        u = self._confounders(inputs)
        constant = self.appearance.concatenate_to(u, inputs)
        position, stable_logit = self.decoder(inputs.initial, constant, inputs.presence, inputs.num_steps)
        return Prediction(position, stable_logit, u if self.source is ConfounderSource.estimated else None)

    def _confounders(self, inputs: Inputs) -> Float[Tensor, "batch slots u"]:
        if self.source is ConfounderSource.estimated:
            observed = self.appearance.concatenate_to(inputs.observed, inputs)
            return self.estimator(observed, inputs.observed_presence)
        if self.num_confounders:
            return true_confounders(inputs, self.num_confounders)
        return inputs.initial[..., :0]  # width 0
