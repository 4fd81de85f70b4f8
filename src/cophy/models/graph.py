"""Message passing between the present objects, all pairs at once."""

from itertools import chain
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import linear


class Graph(NamedTuple):
    """Which objects send to which, as weights of the messages.

    pairs: (N, K, K) receiver × sender, 0 where nothing is sent; received: (N, K, 1), the weights an object receives in
    total.
    """

    pairs: Tensor
    received: Tensor


def neighbours(presence: Tensor, position: Tensor, radius: float | None) -> Graph:
    """Objects closer than `radius` metres (None: all) send to each other; an object receives the sum."""
    others = ~torch.eye(presence.shape[1], dtype=torch.bool, device=presence.device)
    pairs = presence[:, :, None] & presence[:, None, :] & others
    if radius is not None:
        pairs = pairs & ((position[:, :, None] - position[:, None, :]).square().sum(dim=-1) < radius**2)
    weights = pairs.to(position.dtype)
    return Graph(weights, weights.sum(dim=2, keepdim=True))


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
