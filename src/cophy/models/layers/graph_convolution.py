"""Graph convolution over all pairs of present objects (paper Eq. 1)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.layers.graph import Graph, others
from cophy.models.layers.mlp import mlp


class GraphConvolution(nn.Module):
    """Eq. 1: e^k = mean_{j≠k} f(o^k, o^j),  e = mean_k e^k,  õ^k = g(o^k, e^k, e). All objects share f and g.

    Here o^k is whatever is known of object k. In CoPhyNet that is its position, and in the decoder also u^k.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, edge_layers: int, node_layers: int) -> None:
        """Build f and g.

        Args:
            input_dim: Features of an object, o.
            hidden_dim: Width of f and g, and features of õ.
            edge_layers: Linear layers of f.
            node_layers: Linear layers of g.
        """
        super().__init__()
        self.f = PairwiseMLP(input_dim, hidden_dim, layers=edge_layers)
        self.g = mlp(input_dim + 2 * hidden_dim, hidden_dim, node_layers)

    def forward(self, nodes: Float[Tensor, "batch slots input"], graph: Graph) -> Float[Tensor, "batch slots hidden"]:
        """From objects o to õ, which know of each other; the graph says over whom to average."""
        messages = self.f(nodes)  # f(o^k, o^j)
        received = graph.sum_over_senders(messages)  # e^k; the weights of a mean are 1 over the number of senders
        everything = graph.mean_over_objects(received)  # e
        return self.g(torch.cat([nodes, received, everything], dim=-1))


class PairwiseMLP(nn.Module):
    """f(o^k, o^j): an MLP on a receiver and a sender side by side, of all pairs at once.

    The first layer is linear in the pair, so it is the sum of a receiver's half and a sender's half. Both halves are
    computed per object instead of per pair.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int) -> None:
        """Build the MLP.

        Args:
            input_dim: Features of an object.
            hidden_dim: Width of all layers, and features of a message.
            layers: Linear layers, at least 2, with ReLU between them.
        """
        super().__init__()
        self.receiver = nn.Linear(input_dim, hidden_dim)
        self.sender = nn.Linear(input_dim, hidden_dim, bias=False)
        self.further = mlp(hidden_dim, hidden_dim, layers - 1, inplace=True)

    def forward(self, nodes: Float[Tensor, "batch slots input"]) -> Float[Tensor, "batch others slots hidden"]:
        """The message that each slot gets from each of the others."""
        first = torch.relu(self.receiver(nodes)[:, None] + others(self.sender(nodes)))
        pairs = first.flatten(
            0, 2
        )  # one row per pair; of more dimensions PyTorch would copy what ReLU changes in place
        return self.further(pairs).view_as(first)
