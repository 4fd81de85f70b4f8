"""Unsupervised estimation of the confounders (paper Sec. 4.1)."""

from torch import Tensor, nn

from cophy.models.graph import fully_connected


class ConfounderEstimator(nn.Module):
    """Observed AB -> interactions per frame -> GRU per object over time -> its last hidden state, u^k.

    interactions: from nodes (N, K, 3) and a graph to (N, K, hidden). All frames go through it at once; the recurrent
    network is shared by all objects.
    """

    def __init__(self, interactions: nn.Module, *, hidden_dim: int, gru_layers: int) -> None:
        super().__init__()
        self.interactions = interactions
        self.gru = nn.GRU(hidden_dim, hidden_dim, gru_layers, batch_first=True)

    def forward(self, observed: Tensor, presence: Tensor) -> Tensor:
        """(B, T, K, 3), (B, K) -> U (B, K, hidden)."""
        batch, time, slots, _ = observed.shape
        graph = fully_connected(presence.repeat_interleave(time, dim=0))
        nodes = self.interactions(observed.flatten(0, 1), graph).unflatten(0, (batch, time))
        _, hidden = self.gru(nodes.transpose(1, 2).flatten(0, 1))
        return hidden[-1].unflatten(0, (batch, slots))
