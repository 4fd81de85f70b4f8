"""A predictor that rolls D out alongside AB: at every step it sees what happened in AB at that time.

What an object knows of itself in one frame.
When and how two objects would touch in the next step, and what that does to their motion.

Frames are 0.2 s apart: two balls that meet between them are apart in both. So both are moved on along a straight line to the
moment at which they touch. Momentum passes along the normal of that moment, not along the line between two frames.
What every object and every pair goes through in AB.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.cophynet import gate
from cophy.models.layers import (
    OFFSET_DIM,
    Appearance,
    Graph,
    RelativeMessages,
    hear_mean_of_others,
    mlp,
    offsets,
    others,
    pack,
    unpack,
)
from cophy.types import Inputs, Prediction

HIGH = 2.0  # metres; ours: of blocks above it, one in 112,938 is near the ground 0.2 s later (3,000 towers)


@dataclass(frozen=True)
class Own:
    """Height up to `HIGH`, motion, how it looks, and where it is between walls if there are any.

    Attributes:
        arena_half_width: From the middle to each of four walls, metres; None where there are none. Without walls an object
            does not know where on the ground it is, only where it is to others.
        appearance: What is told of how objects look.
    """

    arena_half_width: float | None
    appearance: Appearance

    @property
    def width(self) -> int:
        """Features of an object."""
        return 4 + 4 * (self.arena_half_width is not None) + self.appearance.width

    def of(
        self,
        position: Float[Tensor, "batch slots 3"],
        motion: Float[Tensor, "batch slots 3"],
        reach: Float[Tensor, ""],
        inputs: Inputs,
    ) -> Float[Tensor, "batch slots own"]:
        """Features of all objects.

        Args:
            position: Centres, metres.
            motion: What each moved in the last step, taken for the next one too, metres.
            reach: Metres between two centres as they touch, twice what is between a centre and a wall.
            inputs: What else is known.
        """
        own = [position[..., 2:].clamp(max=HIGH), motion]
        if self.arena_half_width is not None:
            following = (position + motion)[..., :2]
            beyond = (following.abs() - (self.arena_half_width - reach / 2)).relu() * following.sign()
            own += [position[..., :2] / self.arena_half_width, beyond]
        return self.appearance.beside(torch.cat(own, dim=-1), inputs)


CONTACT_DIM = 5  # features of a contact
SMALL = 1e-8  # m²: keeps a root's slope finite
CAUTIOUS = 2.0  # impulses start at σ(-2), 12 % of the most that there can be


@dataclass
class Contact:
    """What each object is about to meet in each of the others (in the order of `others`).

    Attributes:
        moment: Share of the step until they touch, or else are nearest: 0 if they part or overlap already, 1 if they come nearer
            still after it.
        normal: Unit vector from the object to the other at that moment.
        approach: Speed of the other along the normal, as seen from the object, metres per step; negative as they approach.
        slip: What is left of that velocity, metres per step.
        gap: Metres that are between them at that moment.
        touches: 1 where they touch within the step, else 0.
    """

    moment: Float[Tensor, "batch others slots 1"]
    normal: Float[Tensor, "batch others slots 3"]
    approach: Float[Tensor, "batch others slots 1"]
    slip: Float[Tensor, "batch others slots 3"]
    gap: Float[Tensor, "batch others slots 1"]
    touches: Float[Tensor, "batch others slots 1"]

    def features(self) -> Float[Tensor, "batch others slots 5"]:
        """What does not change with the direction from which one looks."""
        return torch.cat([self.moment, self.gap, self.approach, length(self.slip), self.touches], dim=-1)

    def impulse(self, share: Float[Tensor, "batch others slots 2"]) -> Float[Tensor, "batch others slots 3"]:
        """How the other changes the object's motion, metres per step.

        Args:
            share: Logits of how much of the approach and of the slip it takes over. Of the approach it is at most twice
                as much, from an elastic body that is far heavier; of the slip it is at most all.
        """
        of_approach, of_slip = torch.sigmoid(share - CAUTIOUS).chunk(2, dim=-1)
        return 2 * of_approach * self.approach * self.normal + of_slip * self.slip

    def along(self, change: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch others slots 4"]:
        """How the motion of the object and of the other changes, along the normal and along the slip."""
        across = self.slip / length(self.slip)
        pair = (change[:, None].expand_as(self.normal), others(change))
        return torch.cat([dot(each, axis) for axis in (self.normal, across) for each in pair], dim=-1)


class Contacts(nn.Module):
    """Predicts the contacts of spheres that all have one size, which it learns."""

    def __init__(self) -> None:
        """Begin with centres that are 1 m apart as two objects touch."""
        super().__init__()
        self.reach = nn.Parameter(torch.tensor(1.0))

    def forward(self, position: Float[Tensor, "batch slots 3"], motion: Float[Tensor, "batch slots 3"]) -> Contact:
        """What would happen in one step of constant motion.

        Args:
            position: Centres, metres.
            motion: What each would move in the step, metres.
        """
        apart, moving = others(position) - position[:, None], others(motion) - motion[:, None]
        # |apart + s · moving|² = reach² is a quadratic equation for the moment s
        a, b, c = dot(moving, moving) + 1e-6, dot(apart, moving), dot(apart, apart) - self.reach**2
        root = b.square() - a * c
        meets = (root > 0) & (b < 0)
        moment = torch.where(meets, (-b - root.clamp(min=SMALL).sqrt()) / a, -b / a).clamp(0, 1)
        there = apart + moment * moving
        distance = length(there)
        normal = there / distance
        approach = dot(moving, normal)
        touches = (meets & (moment < 1)).to(position.dtype)
        return Contact(moment, normal, approach, moving - approach * normal, distance - self.reach, touches)


def dot(one: Float[Tensor, "*any 3"], other: Float[Tensor, "*any 3"]) -> Float[Tensor, "*any 1"]:
    """The scalar product."""
    return (one * other).sum(dim=-1, keepdim=True)


def length(vectors: Float[Tensor, "*any 3"]) -> Float[Tensor, "*any 1"]:
    """Never quite zero, so that one can divide by it."""
    return dot(vectors, vectors).add(SMALL).sqrt()


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
