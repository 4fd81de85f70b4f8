"""CoPhyNet (paper Sec. 4): predict D from C and what AB tells about the confounders.

observed AB --GCN per frame, GRU over time--> u
                                              |
initial C = o_0 ----------------------> [o_t, u] --GCN--> stability s_t --------------------+
                                         ^    |                                             |
                                         |    +--GCN, GRU over time, linear--> Δ_t --> o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t
                                         |                                                  |
                                         +------------------- next step --------------------+

A model that declares object types or poses gets them beside every position, of AB and of o_t.
"""

from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.appearance import Appearance
from cophy.models.confounder_estimator import ConfounderEstimator
from cophy.models.decoders import Rollout, SingleStep
from cophy.models.layers.graph_convolution import GraphConvolution
from cophy.models.layers.packing import pack, unpack
from cophy.models.layers.slot_mlp import SlotMLP
from cophy.models.options import ConfounderSource, Decoding, Gating, Interaction
from cophy.types import CONFOUNDERS, Inputs, Prediction, true_confounders


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
