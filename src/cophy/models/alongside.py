"""A predictor that rolls D out alongside AB: at every step it sees what happened in AB at that time.

CoPhyNet squeezes AB into one vector per object. Here the decoder reads AB step by step:

    AB --messages per frame, GRU over time in both directions--> h_t    (of every object and frame)

    [own motion, offset from AB, next motion in AB, h_{t+1}] --messages, GRU--> stability s_t, mixture m_t, correction c_t
    Δ_t = m_t · (next motion in AB) + (1 - m_t) · (own last motion) + c_t
    o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.appearance import Appearance
from cophy.models.decoders import gate
from cophy.models.layers.graph import Graph, hear_mean_of_others
from cophy.models.layers.mlp import mlp
from cophy.models.layers.packing import pack, unpack
from cophy.models.layers.relative_messages import OFFSET_DIM, RelativeMessages, offsets
from cophy.types import Inputs, Prediction


class Alongside(nn.Module):
    """Rolls D out alongside AB, object by object and frame by frame. Any number of objects, in any order."""

    def __init__(
        self,
        *,
        hidden_dim: int,
        edge_layers: int,
        temperature: float,
        arena_half_width: float | None,
        object_type: bool = False,
        pose: bool = False,
    ) -> None:
        """Build encoder and decoder.

        Args:
            hidden_dim: Width of all layers.
            edge_layers: Linear layers of messages, at least 2.
            temperature: λ of the gate.
            arena_half_width: From the middle to each of four walls, metres; None where there are none. Without walls it does
                not see where on the ground an object is, only where it is to others.
            object_type: Whether it sees what each object is.
            pose: Whether it sees how each object is turned at t = 0.
        """
        super().__init__()
        self.temperature, self.arena_half_width = temperature, arena_half_width
        self.appearance = Appearance(object_type, pose)
        own_dim = 4 + 2 * (arena_half_width is not None) + self.appearance.width  # height and motion; x and y
        self.seen_messages = RelativeMessages(own_dim, 2 * OFFSET_DIM, hidden_dim, layers=edge_layers)
        self.seen = mlp(own_dim + hidden_dim, hidden_dim, 2)
        self.history = nn.GRU(hidden_dim, hidden_dim, batch_first=True, bidirectional=True)
        node_dim = own_dim + 3 + 3 + 2 * hidden_dim  # offset from AB, next motion in AB, h
        self.messages = RelativeMessages(node_dim, 2 * OFFSET_DIM, hidden_dim, layers=edge_layers)
        self.node = mlp(node_dim + hidden_dim, hidden_dim, 2)
        self.cell = nn.GRUCell(hidden_dim, hidden_dim)
        self.to_step = mlp(hidden_dim + node_dim, hidden_dim, 2, output_dim=5)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        seen = inputs.observed_presence[..., None]  # what a de-renderer missed in AB is not read there
        ab = inputs.observed
        motion = ab[:, 1:] - ab[:, :-1]
        history = self._history(inputs, motion)
        graph = hear_mean_of_others(inputs.presence, ab.dtype)
        position, last, state = inputs.initial, motion[:, 0] * seen, None
        positions, logits = [], []
        for step in range(inputs.num_steps):
            following = motion[:, step] * seen
            offset = (position - ab[:, step]) * seen
            nodes = torch.cat([self._own(position, last, inputs), offset, following, history[:, step + 1]], dim=-1)
            relations = torch.cat([offsets(position), offsets(ab[:, step])], dim=-1)
            heard = graph.sum_over_senders(self.messages(nodes, relations))
            state = self.cell(self.node(torch.cat([nodes, heard], dim=-1)).flatten(0, 1), state)
            known = torch.cat([state.view(*nodes.shape[:2], -1), nodes], dim=-1)
            correction, mixture, logit = self.to_step(known).split([3, 1, 1], dim=-1)
            mixture = torch.sigmoid(mixture)
            displacement = mixture * following + (1 - mixture) * last + correction
            last = gate(logit, self.temperature) * displacement
            position = position + last
            positions.append(position)
            logits.append(logit)
        return Prediction(torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1))

    def _history(
        self, inputs: Inputs, motion: Float[Tensor, "batch steps slots 3"]
    ) -> Float[Tensor, "batch time slots hidden"]:
        """What every object goes through in AB, at every frame in the light of all others."""
        batch, time, slots, _ = inputs.observed.shape
        moved = torch.cat([motion[:, :1], motion], dim=1)
        own = torch.stack([self._own(inputs.observed[:, t], moved[:, t], inputs) for t in range(time)], dim=1)
        present = hear_mean_of_others(inputs.observed_presence, own.dtype)
        every_frame = Graph(*(w.repeat_interleave(time, dim=0) for w in vars(present).values()))
        nodes = own.flatten(0, 1)
        relations = torch.cat([offsets(inputs.observed.flatten(0, 1)), offsets(moved.flatten(0, 1))], dim=-1)
        heard = every_frame.sum_over_senders(self.seen_messages(nodes, relations))
        frames = self.seen(torch.cat([nodes, heard], dim=-1)).view(batch, time, slots, -1)
        passed, _ = self.history(frames.transpose(1, 2).flatten(0, 1))
        return passed.view(batch, slots, time, -1).transpose(1, 2) * inputs.observed_presence[:, None, :, None]

    def _own(
        self, position: Float[Tensor, "batch slots 3"], motion: Float[Tensor, "batch slots 3"], inputs: Inputs
    ) -> Float[Tensor, "batch slots own"]:
        """Height and motion of an object, where it is if that matters, and how it looks."""
        own = [position[..., 2:], motion]
        if self.arena_half_width is not None:
            own.append(position[..., :2] / self.arena_half_width)
        return self.appearance.beside(torch.cat(own, dim=-1), inputs)
