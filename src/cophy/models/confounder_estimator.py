"""Unsupervised estimation of the confounders from AB (paper Sec. 4.1)."""

from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.models.layers.graph import hear_mean_of_others


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
