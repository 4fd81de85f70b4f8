"""Message passing between the present objects, all pairs at once (paper Eq. 1)."""

from itertools import chain
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from cophy.models.mlp import mlp


class Graph(NamedTuple):
    """Which objects send to which, as weights of the messages.

    pairs: (N, K, K) receiver × sender, 0 where nothing is sent; received: (N, K, 1), the weights an object receives in
    total; objects: (N, K), 1/(number of objects) for every present object, 0 for absent ones.
    """

    pairs: Tensor
    received: Tensor
    objects: Tensor


def fully_connected(presence: Tensor) -> Graph:
    """All objects present in (N, K) masks send to all others; an object receives the mean (paper Eq. 1)."""
    pairs = _pairs(presence).to(torch.get_default_dtype())
    weights = pairs / pairs.sum(dim=2, keepdim=True).clamp(min=1)
    return _graph(weights, presence)


def neighbours(presence: Tensor, position: Tensor, radius: float | None) -> Graph:
    """Objects closer than `radius` metres (None: all) send to each other; an object receives the sum."""
    pairs = _pairs(presence)
    if radius is not None:
        pairs = pairs & ((position[:, :, None] - position[:, None, :]).square().sum(dim=-1) < radius**2)
    return _graph(pairs.to(position.dtype), presence)


class Messages(nn.Module):
    """What every object receives: Σ_j w_kj f(o^k, o^j), f an MLP on [receiver, sender].

    f is linear at both ends, which saves work on the K² pairs without changing the function: its first layer is the
    sum of two halves that are computed per object; its last one is applied to the sum of the messages.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int) -> None:
        super().__init__()
        self.receiver = nn.Linear(input_dim, hidden_dim)
        self.sender = nn.Linear(input_dim, hidden_dim, bias=False)
        self.edge = nn.Sequential(
            nn.ReLU(), *chain(*((nn.Linear(hidden_dim, hidden_dim), nn.ReLU()) for _ in range(layers - 2)))
        )
        self.message = nn.Linear(hidden_dim, hidden_dim)

    def forward(self, nodes: Tensor, graph: Graph) -> Tensor:
        """(N, K, input) -> (N, K, hidden); zero for objects that nobody sends to."""
        pairs = self.edge(self.receiver(nodes)[:, :, None] + self.sender(nodes)[:, None, :])
        summed = torch.einsum("nrs,nrsh->nrh", graph.pairs, pairs)
        return linear(summed, self.message.weight) + graph.received * self.message.bias


class GraphConvolution(nn.Module):
    """õ^k = g(o^k, e^k, e) with e^k the mean of f(o^k, o^j) over the others j, and e the mean of e^k over objects."""

    def __init__(self, input_dim: int, hidden_dim: int, *, edge_layers: int, node_layers: int) -> None:
        super().__init__()
        self.messages = Messages(input_dim, hidden_dim, layers=edge_layers)
        self.node = mlp(input_dim + 2 * hidden_dim, hidden_dim, node_layers)

    def forward(self, nodes: Tensor, graph: Graph) -> Tensor:
        """(N, K, input) -> (N, K, hidden)."""
        received = self.messages(nodes, graph)
        everything = torch.einsum("nk,nkh->nh", graph.objects, received)
        return self.node(torch.cat([nodes, received, everything[:, None].expand_as(received)], dim=-1))


def _pairs(presence: Tensor) -> Tensor:
    others = ~torch.eye(presence.shape[1], dtype=torch.bool, device=presence.device)
    return presence[:, :, None] & presence[:, None, :] & others


def _graph(pairs: Tensor, presence: Tensor) -> Graph:
    present = presence.to(pairs.dtype)
    objects = present / present.sum(dim=1, keepdim=True).clamp(min=1)
    return Graph(pairs=pairs, received=pairs.sum(dim=2, keepdim=True), objects=objects)
