"""CoPhyNet (paper Sec. 4): predict D from C and what AB tells about the confounders.

observed AB --GCN per frame, GRU over time--> confounders U --+
                                                              |
initial C --> [o_t, u] --GCN--> stability s_t ----------------+--> o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t
                  |                                           |
                  +------GCN, GRU over time, linear--> Δ_t ---+
"""

from torch import Tensor, nn

from cophy.models.concatenation import Concatenation
from cophy.models.confounder_estimator import ConfounderEstimator
from cophy.models.convolution import GraphConvolution
from cophy.models.decoders import Rollout, SingleStep
from cophy.models.interactions import Interactions
from cophy.models.options import ConfounderSource, Decoding, Gating, Interaction
from cophy.models.packing import pack, unpack
from cophy.types import CONFOUNDERS, Batch, Prediction


class CoPhyNet(nn.Module):
    """The counterfactual predictor and its ablations; with graph interactions K-agnostic and permutation equivariant.

    confounders, gating, interaction, decoding: see `options`. num_frames: T, of a single-step decoder; slots: names of
    the colour slots, of MLP interactions.
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
        num_frames: int | None = None,
        slots: list[str] | None = None,
    ) -> None:
        super().__init__()
        self.source, self.interaction = ConfounderSource(confounders), Interaction(interaction)

        def interactions(input_dim: int) -> Interactions:
            if self.interaction is Interaction.mlp:
                assert slots is not None
                return Concatenation(input_dim, hidden_dim, layers=edge_layers, num_slots=len(slots))
            return GraphConvolution(input_dim, hidden_dim, edge_layers=edge_layers, node_layers=node_layers)

        if self.source is ConfounderSource.estimated:
            self.estimator = ConfounderEstimator(interactions(3), hidden_dim=hidden_dim, gru_layers=gru_layers)
        self.estimate_dim = hidden_dim if self.source is ConfounderSource.estimated else 0
        confounder_dim = {"estimated": hidden_dim, "ground_truth": len(CONFOUNDERS), "none": 0}[confounders]
        sizes = {"input_dim": 3 + confounder_dim, "hidden_dim": hidden_dim}
        self.decoder: nn.Module
        if Decoding(decoding) is Decoding.single_step:
            assert num_frames is not None
            self.decoder = SingleStep(interactions, temperature=temperature, horizon=num_frames - 1, **sizes)
        else:
            self.decoder = Rollout(
                interactions, gru_layers=gru_layers, temperature=temperature, gating=Gating(gating), **sizes
            )

    def forward(self, batch: Batch) -> Prediction:
        """Predict D, one step per frame of AB after the first."""
        if self.interaction is Interaction.mlp:
            return self._predict(batch)
        packed, slots = pack(batch)
        return unpack(self._predict(packed), slots, batch.initial.shape[1])

    def _predict(self, batch: Batch) -> Prediction:
        confounders = self.confounders(batch)
        position, stable_logit = self.decoder(batch, confounders, batch.observed.shape[1] - 1)
        return Prediction(position, stable_logit, confounders if self.source is ConfounderSource.estimated else None)

    def confounders(self, batch: Batch) -> Tensor:
        """(B, K, U): estimated from AB, given, or of width 0."""
        if self.source is ConfounderSource.estimated:
            return self.estimator(batch.observed, batch.observed_presence)
        return batch.confounders if self.source is ConfounderSource.ground_truth else batch.confounders[..., :0]
