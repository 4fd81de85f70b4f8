"""What replaces the graph convolution in the ablation `mlp` (paper Table 6 left)."""

from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.layers.graph import Graph
from cophy.models.layers.mlp import mlp


class SlotMLP(nn.Module):
    """An MLP over all slots side by side. It is tied to their number and order, so it is not equivariant."""

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, num_slots: int) -> None:
        """Build the MLP.

        Args:
            input_dim: Features of an object.
            hidden_dim: Features of an object in the result; the MLP is `num_slots` times as wide.
            layers: Linear layers.
            num_slots: Slots of every batch, empty ones included.
        """
        super().__init__()
        self.network = mlp(num_slots * input_dim, num_slots * hidden_dim, layers)

    def forward(self, nodes: Float[Tensor, "batch slots input"], graph: Graph) -> Float[Tensor, "batch slots hidden"]:
        """From objects to objects that know of each other; empty slots count as zero."""
        present = nodes * graph.present
        return self.network(present.flatten(1)).unflatten(1, (nodes.shape[1], -1))
