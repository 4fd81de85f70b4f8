"""A predictor that rolls D out alongside AB: at every step it sees what happened in AB at that time.

CoPhyNet squeezes AB into one vector per object. Here the decoder reads AB step by step:

    AB --messages per frame, over time--> h_t of every object and frame, r of every pair

    n_t = [own motion v_t, offset from AB, AB's motion in this step and the next, h_{t+1}]
    n_t, r, how pairs would touch --messages, GRU--> s_t, m_t, m'_t, c_t, c'_t, k_t of every object, J_t of every pair

    Δ_t     = m_t · (AB's motion in this step) + (1 - m_t) · (v_t + Σ (1 - τ_t) J_t + c_t)
    v_{t+1} = m'_t · (AB's motion in the next step) + (1 - m'_t) · (k_t v_t + Σ J_t + c'_t)
    o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t

s is stability, m and m' are mixtures, c and c' corrections, k is how much of a motion is kept. J is what another object
changes in the motion, at the moment τ of the step at which the two would touch or be nearest. The sums are over all others:
that objects push only where they touch is learned.

The launch v_0 is AB's first motion, corrected. Once trained, it lets no object move farther in a step than `max_step`: with
more objects than it has seen, a rollout can run away. What would move farther is slowed down, Δ_t and v_{t+1} by one factor.
A long v_{t+1} alone is left as it is: its corrections can undo it, so that it also serves as memory.
"""

import torch
from torch import nn

from cophy.models.alongside.contacts import CONTACT_DIM, Contacts, length
from cophy.models.alongside.history import History, PairMemory
from cophy.models.alongside.own import Own
from cophy.models.appearance import Appearance
from cophy.models.decoders import gate
from cophy.models.layers.graph import hear_mean_of_others, others
from cophy.models.layers.mlp import mlp
from cophy.models.layers.packing import pack, unpack
from cophy.models.layers.relative_messages import OFFSET_DIM, RelativeMessages, offsets
from cophy.types import Inputs, Prediction

PARTS = (3, 3, 1, 1, 1, 1)  # of a step: c, c', m, m', s, k
KEPT = 4.0  # a motion is kept to σ(4) = 98 % at first
FIRST = 0.2  # the last layers start with so much of their usual weights: every rollout starts as half of AB, half of inertia


class Alongside(nn.Module):
    """Rolls D out alongside AB, object by object and frame by frame. Any number of objects, in any order."""

    def __init__(
        self,
        *,
        hidden_dim: int,
        edge_layers: int,
        temperature: float,
        arena_half_width: float | None,
        max_step: float,
        replay: bool,
        impulses: bool,
        pair_memory: bool,
        object_type: bool,
        pose: bool,
    ) -> None:
        """Build encoder and decoder.

        Args:
            hidden_dim: Width of all layers.
            edge_layers: Linear layers of messages, at least 2.
            temperature: λ of the gate.
            arena_half_width: From the middle to each of four walls, metres; None where there are none.
            max_step: How far an object can move in a step once this is trained, metres.
            replay: Whether a step can be taken over from AB; without, m and m' are 0.
            impulses: Whether objects change each other's motion directly; without, J is 0.
            pair_memory: Whether the decoder sees r.
            object_type: Whether it sees what each object is.
            pose: Whether it sees how each object is turned at t = 0.
        """
        super().__init__()
        self.temperature, self.max_step, self.replay = temperature, max_step, replay
        self.own = Own(arena_half_width, Appearance(object_type, pose))
        self.contacts = Contacts()
        self.history = History(self.own, self.contacts, hidden_dim, edge_layers)
        self.memory = PairMemory(hidden_dim) if pair_memory else None
        node_dim = self.own.width + 9 + 2 * hidden_dim  # offset from AB, two motions of AB, h
        relation_dim = 2 * OFFSET_DIM + CONTACT_DIM + hidden_dim * pair_memory
        self.messages = RelativeMessages(node_dim, relation_dim, hidden_dim, layers=edge_layers)
        self.push = nn.Linear(hidden_dim, 2) if impulses else None
        self.node = mlp(node_dim + hidden_dim, hidden_dim, 2)
        self.cell = nn.GRUCell(hidden_dim, hidden_dim)
        self.to_step = mlp(hidden_dim + node_dim, hidden_dim, 2, output_dim=sum(PARTS))
        self.launch = mlp(2 * hidden_dim + 3, hidden_dim, 2, output_dim=3)
        for last in filter(None, (self.to_step[-1], self.launch[-1], self.push, self.messages.further[-1])):
            for parameter in last.parameters():
                nn.init.uniform_(parameter, -FIRST * hidden_dim**-0.5, FIRST * hidden_dim**-0.5)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        # what a de-renderer missed in AB seems to lie still there
        ab, seen = inputs.observed, inputs.observed_presence[..., None]
        motion = (ab[:, 1:] - ab[:, :-1]) * seen[:, None]
        before = torch.cat([motion[:, :1], motion], dim=1)
        after = torch.cat([motion[:, 1:], motion[:, -1:], motion[:, -1:]], dim=1)
        history, seen_messages = self.history(inputs, before, after)
        graph = hear_mean_of_others(inputs.presence, ab.dtype)
        both_present = graph.pair_weights > 0
        both_seen = others(inputs.observed_presence)[..., None] & inputs.observed_presence[:, None, :, None]
        memory = [] if self.memory is None else [self.memory(seen_messages) * both_seen]
        velocity = motion[:, 0] + self.launch(torch.cat([history[:, 0], motion[:, 0]], dim=-1)) * seen
        position, state = inputs.initial, None
        positions, logits = [], []
        for step in range(inputs.num_steps):
            own = self.own.of(position, velocity, self.contacts.reach, inputs)
            offset = (position - ab[:, step]) * seen
            nodes = torch.cat([own, offset, motion[:, step], after[:, step], history[:, step + 1]], dim=-1)
            contact = self.contacts(position, velocity)
            relations = [offsets(position), offsets(ab[:, step]), contact.features()]
            messages = self.messages(nodes, torch.cat([*relations, *memory], dim=-1))
            heard = graph.sum_over_senders(messages)
            state = self.cell(self.node(torch.cat([nodes, heard], dim=-1)).flatten(0, 1), state)
            known = torch.cat([state.view(*nodes.shape[:2], -1), nodes], dim=-1)
            shift, turn, mixture, next_mixture, logit, kept = self.to_step(known).split(PARTS, dim=-1)
            mixture, next_mixture = (torch.sigmoid(each) * self.replay for each in (mixture, next_mixture))
            displacement, velocity = velocity + shift, velocity * torch.sigmoid(kept + KEPT) + turn
            if self.push is not None:
                impulse = contact.impulse(self.push(messages)) * both_present
                displacement = displacement + ((1 - contact.moment) * impulse).sum(dim=1)
                velocity = velocity + impulse.sum(dim=1)
            displacement = mixture * motion[:, step] + (1 - mixture) * displacement
            velocity = next_mixture * after[:, step] + (1 - next_mixture) * velocity
            if not self.training:
                slowed = (self.max_step / length(displacement)).clamp(max=1)
                velocity, displacement = slowed * velocity, slowed * displacement
            position = position + gate(logit, self.temperature) * displacement
            positions.append(position)
            logits.append(logit)
        return Prediction(torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1))
