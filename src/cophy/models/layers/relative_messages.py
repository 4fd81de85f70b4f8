"""Messages between objects that depend on how they lie to each other, of all pairs at once."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.layers.graph import others
from cophy.models.layers.mlp import mlp

OFFSET_DIM = 4  # features of `offsets`


class RelativeMessages(nn.Module):
    """f(o^k, o^j, r^jk): as in Eq. 1, and with what lies between sender and receiver.

    The first layer is linear, so its three parts are computed apart: of receivers and senders per object, of relations per pair.
    """

    def __init__(self, input_dim: int, relation_dim: int, hidden_dim: int, *, layers: int) -> None:
        """Build f.

        Args:
            input_dim: Features of an object.
            relation_dim: Features of a pair.
            hidden_dim: Width of all layers, and features of a message.
            layers: Linear layers, at least 2.
        """
        super().__init__()
        self.receiver = nn.Linear(input_dim, hidden_dim)
        self.sender = nn.Linear(input_dim, hidden_dim, bias=False)
        self.relation = nn.Linear(relation_dim, hidden_dim, bias=False)
        self.further = mlp(hidden_dim, hidden_dim, layers - 1, inplace=True)

    def forward(
        self, nodes: Float[Tensor, "batch slots input"], relations: Float[Tensor, "batch others slots relation"]
    ) -> Float[Tensor, "batch others slots hidden"]:
        """The message that each slot gets from each of the others."""
        of_objects = self.receiver(nodes)[:, None] + others(self.sender(nodes))
        first = torch.relu(of_objects + self.relation(relations))
        return self.further(first.flatten(0, 2)).view_as(first)


def offsets(vectors: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch others slots 4"]:
    """From each receiver to each of the others: the difference of a vector, and its length."""
    difference = others(vectors) - vectors[:, None]
    return torch.cat([difference, difference.square().sum(dim=-1, keepdim=True).add(1e-8).sqrt()], dim=-1)
