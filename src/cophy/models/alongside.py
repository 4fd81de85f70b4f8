"""Alongside: a predictor that reads AB step by step while it rolls D out. It is not in the paper.

CoPhyNet summarises AB in one vector per object. Here, the decoder at every step sees what happened in AB at that time:

    AB --messages per frame, GRU over time--> h_t of every object and frame, r of every pair

    n_t = [own motion v_t, offset from AB, motion in AB in this step and the next, h_{t+1}]
    n_t, r, contacts of pairs --messages, GRU--> s_t, m_t, m'_t, c_t, c'_t, k_t of every object, J_t of every pair

    Δ_t     = m_t · (motion in AB in this step) + (1 - m_t) · (v_t + Σ (1 - τ_t) J_t + c_t)
    v_{t+1} = m'_t · (motion in AB in the next step) + (1 - m'_t) · (k_t v_t + Σ J_t + c'_t)
    o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t

s is the stability, m and m' are mixture weights, c and c' corrections, and k is the share of the motion that is kept. J is the
impulse from another object at the time τ within the step at which the two would touch or be nearest: a pair keeps its momentum
and gains no energy. Sums are over all other objects: the network learns that impulses need contact.

The initial velocity v_0 is the first motion of AB plus a learned correction. No object moves farther in a step than
`max_step`, because a rollout can diverge, early in training or with more objects than in training: Δ_t and v_{t+1} are
scaled by one factor. v_{t+1} itself is not clipped: later corrections can cancel it, so the network may use it as memory.
Gradients are limited at every step, too.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.contacts import CONTACT_DIM, OFFSET_DIM, Contacts, offsets
from cophy.models.cophynet import gate
from cophy.models.frames import check_frame, predict_in_frame
from cophy.models.layers import (
    Appearance,
    PairwiseMLP,
    check_at_least,
    check_layers,
    check_positive,
    mean_graph,
    mlp,
    others,
    pack,
    unpack,
)
from cophy.models.rollout import limit_gradient, share_within
from cophy.types import Inputs, Prediction

MAX_HEIGHT_M = 2.0  # ours: of blocks above it, one in 112,938 is near the ground 0.2 s later (3,000 towers)
STEP_DIMS = (3, 3, 1, 1, 1, 1)  # outputs of a step: c, c', m, m', s, k
KEPT_LOGIT_OFFSET = 4.0  # k starts at σ(4) = 98 %
INITIAL_WEIGHT_SCALE = 0.2  # of the last layers: before training, a rollout is half AB and half constant velocity


@dataclass(frozen=True)
class EgoFeatures:
    """Features of one object in one frame: height (up to `MAX_HEIGHT_M`), motion, appearance and distance to walls.

    Attributes:
        arena_half_width: Distance from the origin to each of four walls, metres; None without walls. Without walls, an
            object does not know its place on the ground, only its place relative to others.
        appearance: Optional inputs that describe how objects look.
    """

    arena_half_width: float | None
    appearance: Appearance

    @property
    def width(self) -> int:
        """Number of features of an object."""
        return 4 + 4 * (self.arena_half_width is not None) + self.appearance.width

    def compute(
        self,
        position: Float[Tensor, "batch *time slots 3"],
        motion: Float[Tensor, "batch *time slots 3"],
        reach: Float[Tensor, ""],
        inputs: Inputs,
    ) -> Float[Tensor, "batch *time slots features"]:
        """Return the features of all objects.

        Args:
            position: Centres, metres.
            motion: Displacement in the last step, assumed for the next one too, metres.
            reach: Distance of two centres at contact, and twice that of a centre and a wall, metres.
            inputs: Object types and poses, where enabled.
        """
        features = [position[..., 2:].clamp(max=MAX_HEIGHT_M), motion]
        if self.arena_half_width is not None:
            next_xy = (position + motion)[..., :2]
            beyond_wall = (next_xy.abs() - (self.arena_half_width - reach / 2)).relu() * next_xy.sign()
            features += [position[..., :2] / self.arena_half_width, beyond_wall]
        return self.appearance.concatenate_to(torch.cat(features, dim=-1), inputs)


class History(nn.Module):
    """Encoder of AB: messages per frame, then a bidirectional GRU over time.

    A step during which two objects collide mixes the motions before and after the collision. So the change of motion at a frame
    is from the step before it to the step after the next frame. At the end of AB, the last motion is repeated.
    """

    def __init__(self, ego: EgoFeatures, contacts: Contacts, hidden_dim: int, edge_layers: int) -> None:
        """Build the layers; `edge_layers` is the number of linear layers of messages, at least 2."""
        super().__init__()
        self.ego, self.contacts = ego, contacts
        node_dim, relation_dim = ego.width + 3, OFFSET_DIM + CONTACT_DIM + 4
        self.messages = PairwiseMLP(node_dim, hidden_dim, layers=edge_layers, relation_dim=relation_dim)
        self.frame = mlp(node_dim + hidden_dim, hidden_dim, 2)
        self.over_time = nn.GRU(hidden_dim, hidden_dim, batch_first=True, bidirectional=True)

    def forward(
        self,
        inputs: Inputs,
        before: Float[Tensor, "batch time slots 3"],
        after: Float[Tensor, "batch time slots 3"],
    ) -> tuple[Float[Tensor, "batch time slots twice_hidden"], Float[Tensor, "batch time others slots hidden"]]:
        """Encode AB.

        Args:
            inputs: AB and the presence of objects.
            before: Motion in the step before each frame, metres.
            after: Motion in the step after the next frame, metres.

        Returns:
            Features of every object and the messages of every pair, at every frame.
        """
        batch, time, slots, _ = inputs.observed.shape
        ego = self.ego.compute(inputs.observed, before, self.contacts.reach, inputs)
        position, motion, change = (each.flatten(0, 1) for each in (inputs.observed, before, after - before))
        nodes = torch.cat([ego.flatten(0, 1), change], dim=-1)
        pose = None if inputs.pose is None else inputs.pose.repeat_interleave(time, dim=0)
        contact = self.contacts(position, motion, pose)
        relations = torch.cat([offsets(position), contact.features(), contact.along(change)], dim=-1)
        messages = self.messages(nodes, relations)
        graph = mean_graph(inputs.observed_presence.repeat_interleave(time, dim=0), position.dtype)
        received = graph.sum_over_senders(messages)
        frames = self.frame(torch.cat([nodes, received], dim=-1)).view(batch, time, slots, -1)
        states, _ = self.over_time(frames.transpose(1, 2).flatten(0, 1))
        states = states.view(batch, slots, time, -1).transpose(1, 2) * inputs.observed_presence[:, None, :, None]
        return states, messages.view(batch, time, slots - 1, slots, -1)


class PairMemory(nn.Module):
    """Summary of the messages of a pair in AB: an attention over all frames, one weight per feature."""

    def __init__(self, hidden_dim: int) -> None:
        """Build the layers, `hidden_dim` wide."""
        super().__init__()
        self.attention = nn.Linear(hidden_dim, hidden_dim)
        self.value = nn.Linear(hidden_dim, hidden_dim)

    def forward(
        self, messages: Float[Tensor, "batch time others slots hidden"]
    ) -> Float[Tensor, "batch others slots hidden"]:
        """Return one vector per pair."""
        return (self.attention(messages).softmax(dim=1) * self.value(messages)).sum(dim=1)


class Alongside(nn.Module):
    """Rolls D out alongside AB, object by object and frame by frame, with any number of objects in any order.

    Args:
        hidden_dim: Width of all layers.
        edge_layers: Linear layers of messages, at least 2.
        temperature: λ of the gate.
        arena_half_width: Distance from the origin to each of four walls, metres; None without walls.
        max_step: Largest displacement of an object in a step, metres.
        replay: Whether the motion of AB can be used; otherwise m and m' are 0.
        impulses: Whether objects change each other's motion directly; otherwise J is 0.
        pair_memory: Whether the decoder sees r.
        object_type: Whether the model sees the type of each object.
        pose: Whether the model sees the orientation of each object at t = 0.
        canonical_frame: Name of the scenario whose symmetries are removed from the positions (`cophy.models.frames`);
            None for positions as they are.

    Raises:
        CophyError: An argument is out of its range.

    Attributes:
        limits_gradients: Whether it uses `limit_gradient`, which scaled losses (precision 16-mixed) undo.
    """

    limits_gradients = True

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
        canonical_frame: str | None = None,
    ) -> None:
        super().__init__()
        check_at_least(1, hidden_dim=hidden_dim)
        check_layers(2, edge_layers=edge_layers)
        check_positive(temperature=temperature, arena_half_width=arena_half_width, max_step=max_step)
        check_frame(canonical_frame)
        self.canonical_frame = canonical_frame
        self.temperature, self.max_step, self.replay = temperature, max_step, replay
        self.ego = EgoFeatures(arena_half_width, Appearance(object_type, pose))
        # The names of modules are those of weights in checkpoints.
        self.contacts = Contacts()
        self.history = History(self.ego, self.contacts, hidden_dim, edge_layers)
        self.memory = PairMemory(hidden_dim) if pair_memory else None
        node_dim = self.ego.width + 9 + 2 * hidden_dim  # offset from AB, two motions of AB, h
        relation_dim = 2 * OFFSET_DIM + CONTACT_DIM + hidden_dim * pair_memory
        self.messages = PairwiseMLP(node_dim, hidden_dim, layers=edge_layers, relation_dim=relation_dim)
        self.push = nn.Linear(hidden_dim, 3) if impulses else None
        self.node = mlp(node_dim + hidden_dim, hidden_dim, 2)
        self.cell = nn.GRUCell(hidden_dim, hidden_dim)
        self.to_step = mlp(hidden_dim + node_dim, hidden_dim, 2, output_dim=sum(STEP_DIMS))
        self.launch = mlp(2 * hidden_dim + 3, hidden_dim, 2, output_dim=3)  # corrects the initial velocity
        bound = INITIAL_WEIGHT_SCALE * hidden_dim**-0.5
        for layer in filter(None, (self.to_step[-1], self.launch[-1], self.push, self.messages.further[-1])):
            for parameter in layer.parameters():
                nn.init.uniform_(parameter, -bound, bound)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        return predict_in_frame(self._predict_with_slots, inputs, self.canonical_frame)

    def _predict_with_slots(self, inputs: Inputs) -> Prediction:
        packed, slots = pack(inputs if self.ego.appearance.pose else replace(inputs, pose=None))
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        # an object that a de-renderer missed in AB has no motion there
        ab, seen = inputs.observed, inputs.observed_presence[..., None]
        motion = (ab[:, 1:] - ab[:, :-1]) * seen[:, None]
        before = torch.cat([motion[:, :1], motion], dim=1)
        after = torch.cat([motion[:, 1:], motion[:, -1:], motion[:, -1:]], dim=1)
        history, observed_messages = self.history(inputs, before, after)
        graph = mean_graph(inputs.presence, ab.dtype)
        both_present = graph.pair_weights > 0
        both_seen = others(inputs.observed_presence)[..., None] & inputs.observed_presence[:, None, :, None]
        memory = [] if self.memory is None else [self.memory(observed_messages) * both_seen]
        velocity = motion[:, 0] + self.launch(torch.cat([history[:, 0], motion[:, 0]], dim=-1)) * seen
        position, state = inputs.initial, None
        positions, logits = [], []
        for step in range(inputs.num_steps):
            ego = self.ego.compute(position, velocity, self.contacts.reach, inputs)
            offset = (position - ab[:, step]) * seen
            nodes = torch.cat([ego, offset, motion[:, step], after[:, step], history[:, step + 1]], dim=-1)
            contact = self.contacts(position, velocity, inputs.pose)
            relations = [offsets(position), offsets(ab[:, step]), contact.features()]
            messages = self.messages(nodes, torch.cat([*relations, *memory], dim=-1))
            received = graph.sum_over_senders(messages)
            state = self.cell(self.node(torch.cat([nodes, received], dim=-1)).flatten(0, 1), state)
            features = torch.cat([state.view(*nodes.shape[:2], -1), nodes], dim=-1)
            c, c_next, mixture, mixture_next, logit, kept = self.to_step(features).split(STEP_DIMS, dim=-1)
            mixture, mixture_next = (torch.sigmoid(each) * self.replay for each in (mixture, mixture_next))
            displacement, velocity = velocity + c, velocity * torch.sigmoid(kept + KEPT_LOGIT_OFFSET) + c_next
            if self.push is not None:
                impulse = contact.impulse(self.push(messages)) * both_present
                displacement = displacement + ((1 - contact.moment) * impulse).sum(dim=1)
                velocity = velocity + impulse.sum(dim=1)
            displacement = mixture * motion[:, step] + (1 - mixture) * displacement
            velocity = mixture_next * after[:, step] + (1 - mixture_next) * velocity
            scale = share_within(self.max_step, displacement)
            velocity = limit_gradient(scale * velocity)
            position = limit_gradient(position + gate(logit, self.temperature) * scale * displacement)
            positions.append(position)
            logits.append(logit)
        return Prediction(torch.stack(positions, dim=1), torch.stack(logits, dim=1).squeeze(-1))
