"""Graph convolution over the present objects, all pairs connected (paper Eq. 1)."""

from itertools import chain
from typing import NamedTuple

import torch
from torch import Tensor, nn

from cophy.models.mlp import mlp


class Graph(NamedTuple):
    """Fully connected graph of the present objects, as averaging weights.

    pairs: (N, K, K) receiver × sender, 1/|Ω_k| for every neighbour; objects: (N, K), 1/K for every present object;
    has_neighbours: (N, K, 1), 0 for objects that are alone or absent.
    """

    pairs: Tensor
    objects: Tensor
    has_neighbours: Tensor


def fully_connected(presence: Tensor) -> Graph:
    """The graph of the objects present in (N, K) masks; an object alone receives nothing."""
    present = presence.float()
    others = ~torch.eye(presence.shape[1], dtype=torch.bool, device=presence.device)
    pairs = present[:, :, None] * present[:, None, :] * others
    num_neighbours = pairs.sum(dim=2, keepdim=True)
    return Graph(
        pairs=pairs / num_neighbours.clamp(min=1),
        has_neighbours=(num_neighbours > 0).float(),
        objects=present / present.sum(dim=1, keepdim=True).clamp(min=1),
    )


class GraphConvolution(nn.Module):
    """õ^k = g(o^k, e^k, e) with e^k the mean of f(o^k, o^j) over neighbours j and e the mean of e^k over objects.

    f is linear at both ends, which saves work on the K² pairs without changing the function: its first layer, on
    [receiver, sender], is the sum of two halves that are computed per object; its last one is applied to the mean of
    the messages instead of to each of them.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, edge_layers: int, node_layers: int) -> None:
        super().__init__()
        self.receiver = nn.Linear(input_dim, hidden_dim)
        self.sender = nn.Linear(input_dim, hidden_dim, bias=False)
        self.edge = nn.Sequential(
            nn.ReLU(), *chain(*((nn.Linear(hidden_dim, hidden_dim), nn.ReLU()) for _ in range(edge_layers - 2)))
        )
        self.message = nn.Linear(hidden_dim, hidden_dim)
        self.node = mlp(input_dim + 2 * hidden_dim, hidden_dim, node_layers)

    def forward(self, nodes: Tensor, graph: Graph) -> Tensor:
        """(N, K, input) -> (N, K, hidden)."""
        pairs = self.edge(self.receiver(nodes)[:, :, None] + self.sender(nodes)[:, None, :])
        mean = torch.einsum("nrs,nrsh->nrh", graph.pairs, pairs)
        received = self.message(mean) * graph.has_neighbours
        everything = torch.einsum("nk,nkh->nh", graph.objects, received)
        return self.node(torch.cat([nodes, received, everything[:, None].expand_as(received)], dim=-1))
