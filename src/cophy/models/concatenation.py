"""What replaces the graph convolution in the ablation `mlp` (paper Table 6 left)."""

from torch import Tensor, nn

from cophy.models.graph import Graph
from cophy.models.mlp import mlp


class Concatenation(nn.Module):
    """An MLP over the concatenated slots: tied to their number and order, so not equivariant to permutations."""

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, num_slots: int) -> None:
        super().__init__()
        self.network = mlp(num_slots * input_dim, num_slots * hidden_dim, layers)

    def forward(self, nodes: Tensor, graph: Graph) -> Tensor:
        """(N, K, input) -> (N, K, hidden); absent slots count as zero."""
        present = (graph.objects > 0).unsqueeze(-1)
        return self.network((nodes * present).flatten(1)).unflatten(1, (nodes.shape[1], -1))
