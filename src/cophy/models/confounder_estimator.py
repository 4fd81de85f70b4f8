"""Unsupervised estimation of the confounders (paper Sec. 4.1)."""

from torch import Tensor, nn

from cophy.models.interactions import Interactions
from cophy.models.recurrence import layers_of


class ConfounderEstimator(nn.Module):
    """Observed AB -> interactions per frame -> GRU per object over time -> its last hidden state, u^k.

    interactions: of nodes of width 3. All frames go through it at once; the recurrent network is shared by all objects.
    """

    def __init__(self, interactions: Interactions, *, hidden_dim: int, gru_layers: int) -> None:
        super().__init__()
        self.interactions = interactions
        self.gru = nn.GRU(hidden_dim, hidden_dim, gru_layers)

    def forward(self, observed: Tensor, presence: Tensor) -> Tensor:
        """(B, T, K, 3), (B, K) -> U (B, K, hidden)."""
        position = observed.permute(2, 1, 0, 3)
        slots, time, batch, _ = position.shape
        present = presence.t()[:, None].expand(slots, time, batch).flatten(1)
        first, *others = layers_of(self.gru)
        position = position.flatten(0, 2)
        (inputs,) = self.interactions.together([(self.interactions, first.input)], present, position[:, :0])(position)
        states = first.over_time(inputs.view(slots, time, batch, -1).transpose(0, 1).flatten(1, 2))
        for layer in others:
            states = layer.over_time(layer.input(states))
        return states[-1].view(slots, batch, -1).transpose(0, 1)
