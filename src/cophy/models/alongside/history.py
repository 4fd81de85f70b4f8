"""What every object and every pair goes through in AB."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.alongside.contacts import CONTACT_DIM, Contacts
from cophy.models.alongside.own import Own
from cophy.models.layers.graph import Graph, hear_mean_of_others
from cophy.models.layers.mlp import mlp
from cophy.models.layers.relative_messages import OFFSET_DIM, RelativeMessages, offsets
from cophy.types import Inputs


class History(nn.Module):
    """Messages per frame, then a GRU over time in both directions.

    If two objects collide between two frames, that step mixes the motions before and after. So the change at a frame is from
    the step before it to the step after the next frame. At the end, where none is left, the last motion is repeated.
    """

    def __init__(self, own: Own, contacts: Contacts, hidden_dim: int, edge_layers: int) -> None:
        """Build the layers.

        Args:
            own: What an object knows of itself.
            contacts: Predicts contacts.
            hidden_dim: Width of all layers.
            edge_layers: Linear layers of messages, at least 2.
        """
        super().__init__()
        self.own, self.contacts = own, contacts
        node_dim = own.width + 3
        self.messages = RelativeMessages(node_dim, OFFSET_DIM + CONTACT_DIM + 4, hidden_dim, layers=edge_layers)
        self.frame = mlp(node_dim + hidden_dim, hidden_dim, 2)
        self.over_time = nn.GRU(hidden_dim, hidden_dim, batch_first=True, bidirectional=True)

    def forward(
        self,
        inputs: Inputs,
        before: Float[Tensor, "batch time slots 3"],
        after: Float[Tensor, "batch time slots 3"],
    ) -> tuple[Float[Tensor, "batch time slots twice_hidden"], Float[Tensor, "batch time others slots hidden"]]:
        """Read AB.

        Args:
            inputs: AB and who is there.
            before: Motion in the step before each frame, metres.
            after: Motion in the step after the next frame, metres.

        Returns:
            Of every object what it goes through, and of every pair the messages, at every frame.
        """
        batch, time, slots, _ = inputs.observed.shape
        own = [self.own.of(inputs.observed[:, t], before[:, t], self.contacts.reach, inputs) for t in range(time)]
        position, motion, change = (each.flatten(0, 1) for each in (inputs.observed, before, after - before))
        nodes = torch.cat([torch.stack(own, dim=1).flatten(0, 1), change], dim=-1)
        contact = self.contacts(position, motion)
        relations = torch.cat([offsets(position), contact.features(), contact.along(change)], dim=-1)
        messages = self.messages(nodes, relations)
        present = hear_mean_of_others(inputs.observed_presence, position.dtype)
        every_frame = Graph(*(weights.repeat_interleave(time, dim=0) for weights in vars(present).values()))
        heard = every_frame.sum_over_senders(messages)
        frames = self.frame(torch.cat([nodes, heard], dim=-1)).view(batch, time, slots, -1)
        passed, _ = self.over_time(frames.transpose(1, 2).flatten(0, 1))
        of_objects = passed.view(batch, slots, time, -1).transpose(1, 2) * inputs.observed_presence[:, None, :, None]
        return of_objects, messages.view(batch, time, slots - 1, slots, -1)


class PairMemory(nn.Module):
    """What was between two objects in AB: an attention over the messages of all frames, one weight per feature."""

    def __init__(self, hidden_dim: int) -> None:
        """Build the layers, `hidden_dim` wide."""
        super().__init__()
        self.attention = nn.Linear(hidden_dim, hidden_dim)
        self.value = nn.Linear(hidden_dim, hidden_dim)

    def forward(
        self, messages: Float[Tensor, "batch time others slots hidden"]
    ) -> Float[Tensor, "batch others slots hidden"]:
        """One vector per pair."""
        return (self.attention(messages).softmax(dim=1) * self.value(messages)).sum(dim=1)
