"""What a model may be told of how objects look at t = 0, beside where they are: their types and their poses.

The one builder of multi-layer perceptrons.
Which objects hear which, and with what weight; all pairs of objects at once.
Graph convolution over all pairs of present objects (paper Eq. 1).
Messages between objects that depend on how they lie to each other, of all pairs at once.
What replaces the graph convolution in the ablation `mlp` (paper Table 6 left).
Leave out the slots that no experiment of a batch needs: 4 balls fill 4 of 9 slots, and pairs cost the square.
"""

from dataclasses import dataclass, fields
from itertools import pairwise
from types import NoneType
from typing import Any, get_args

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn

from cophy.types import OBJECT_TYPES, POSE, Inputs, Prediction


def mlp(
    input_dim: int, hidden_dim: int, num_layers: int, output_dim: int | None = None, *, inplace: bool = False
) -> nn.Sequential:
    """Linear layers with ReLU between them (paper, appendix).

    Args:
        input_dim: Features of the input.
        hidden_dim: Width of every layer but the last.
        num_layers: Linear layers.
        output_dim: Width of the last layer; None for `hidden_dim`.
        inplace: Whether ReLU overwrites its input. That saves time where the MLP is given a matrix, and costs some else.
    """
    widths = [input_dim, *[hidden_dim] * (num_layers - 1), output_dim or hidden_dim]
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU(inplace)]
    return nn.Sequential(*layers[:-1])


def others(objects: Shaped[Tensor, "batch slots *features"]) -> Shaped[Tensor, "batch others slots *features"]:
    """What the other slots hold, for each slot: K - 1 copies of the slots, rotated by 1, 2, … K - 1.

    `others(x)[:, j, k]` is `x[:, (k - 1 - j) % K]` for j = 0 … K - 2. So every slot meets every other once and itself
    never. Empty slots are met too; a `Graph` gives them the weight 0.
    """
    return torch.stack([objects.roll(shift, dims=1) for shift in range(1, objects.shape[1])], dim=1)


@dataclass
class Graph:
    """Who is there, and with what weight objects hear each other.

    Attributes:
        present: 1 for a slot that holds an object, else 0.
        pair_weights: Weight with which a slot hears each of the others (in the order of `others`); 0 for not at all.
        mean_weights: Weight of each slot in a mean over all objects.
    """

    present: Float[Tensor, "batch slots 1"]
    pair_weights: Float[Tensor, "batch others slots 1"]
    mean_weights: Float[Tensor, "batch slots 1"]

    def sum_over_senders(
        self, messages: Float[Tensor, "batch others slots hidden"]
    ) -> Float[Tensor, "batch slots hidden"]:
        """What each slot hears: the weighted sum of its messages; zero for an object that hears nobody."""
        return (self.pair_weights * messages).sum(dim=1)

    def mean_over_objects(self, objects: Float[Tensor, "batch slots hidden"]) -> Float[Tensor, "batch slots hidden"]:
        """The mean over all present objects, the same in every slot."""
        return (self.mean_weights * objects).sum(dim=1, keepdim=True).expand_as(objects)


def hear_mean_of_others(presence: Bool[Tensor, "batch slots"], dtype: torch.dtype) -> Graph:
    """The graph of Eq. 1: every present object hears the mean over all others that are present."""
    heard = (others(presence) & presence[:, None]).to(dtype)[..., None]
    return _graph(presence, heard / heard.sum(dim=1, keepdim=True).clamp(min=1))


def hear_sum_of_near(
    radius: float | None, position: Float[Tensor, "batch slots 3"], presence: Bool[Tensor, "batch slots"]
) -> Graph:
    """The graph of the baselines: every present object hears the sum over all others that are near.

    Args:
        radius: Metres between two centres; None for all others, however far.
        position: Centres, metres.
        presence: Which slots hold an object.
    """
    heard = others(presence) & presence[:, None]
    if radius is not None:
        heard = heard & ((others(position) - position[:, None]).square().sum(dim=-1) < radius**2)
    return _graph(presence, heard.to(position.dtype)[..., None])


def _graph(presence: Bool[Tensor, "batch slots"], pair_weights: Float[Tensor, "batch others slots 1"]) -> Graph:
    present = presence.to(pair_weights.dtype)[..., None]
    return Graph(present, pair_weights, present / present.sum(dim=1, keepdim=True).clamp(min=1))


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


class SlotMLP(nn.Module):
    """An MLP over all slots side by side. It is tied to their number and order, so it is not equivariant."""

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, num_slots: int) -> None:
        """Build the MLP.

        Args:
            input_dim: Features of an object.
            hidden_dim: Features of an object in the result; the MLP is `num_slots` times as wide.
            layers: Linear layers.
            num_slots: Slots of every batch, empty ones included.
        """
        super().__init__()
        self.network = mlp(num_slots * input_dim, num_slots * hidden_dim, layers)

    def forward(self, nodes: Float[Tensor, "batch slots input"], graph: Graph) -> Float[Tensor, "batch slots hidden"]:
        """From objects to objects that know of each other; empty slots count as zero."""
        present = nodes * graph.present
        return self.network(present.flatten(1)).unflatten(1, (nodes.shape[1], -1))


MIN_SLOTS = 2  # so that there is always another object, present or not


def pack(inputs: Inputs) -> tuple[Inputs, Int[Tensor, "batch packed"]]:
    """Move the objects of every experiment to the front; also return the slot that each came from."""
    used = inputs.observed_presence | inputs.presence
    width = max(MIN_SLOTS, int(used.sum(dim=1).max()))
    slots = used.float().argsort(dim=1, descending=True, stable=True)[:, :width]
    packed: dict[str, Any] = {}
    for name, axis in _slot_axes(Inputs).items():
        tensor = getattr(inputs, name)
        packed[name] = None if tensor is None else tensor.gather(axis, _index(slots, tensor, axis))
    return Inputs(**packed), slots


def unpack(prediction: Prediction, slots: Int[Tensor, "batch packed"], num_slots: int) -> Prediction:
    """Put every object back into its slot.

    Args:
        prediction: What was predicted from packed inputs.
        slots: The slot that each object came from, see `pack`.
        num_slots: Slots that there are.

    Returns:
        The prediction; empty slots are zero.
    """
    unpacked: dict[str, Any] = {}
    for name, axis in _slot_axes(Prediction).items():
        tensor = getattr(prediction, name)
        unpacked[name] = None if tensor is None else _scatter(tensor, slots, num_slots, axis)
    return Prediction(**unpacked)


def _slot_axes(kind: type[Inputs] | type[Prediction]) -> dict[str, int]:
    """Of every field, the axis that its annotation calls `slots`."""
    axes = {}
    for field in fields(kind):
        (tensor,) = [each for each in get_args(field.type) or (field.type,) if each is not NoneType]
        axes[field.name] = tensor.dim_str.split().index("slots")
    return axes


def _index(slots: Tensor, like: Tensor, axis: int) -> Tensor:
    """`slots` (batch, packed), as wide as `like` along all other axes."""
    shape = [1] * like.ndim
    shape[0], shape[axis] = slots.shape
    sizes = list(like.shape)
    sizes[axis] = slots.shape[1]
    return slots.view(shape).expand(sizes)


def _scatter(tensor: Tensor, slots: Tensor, num_slots: int, axis: int) -> Tensor:
    shape = list(tensor.shape)
    shape[axis] = num_slots
    empty = torch.zeros(shape, dtype=tensor.dtype, device=tensor.device)
    return empty.scatter(axis, _index(slots, tensor, axis), tensor)


@dataclass(frozen=True)
class Appearance:
    """What of it a model's configuration declares. The paper's models see positions alone.

    Attributes:
        object_type: Whether the model sees which objects are boxes, spheres and cylinders.
        pose: Whether it sees how they are turned.
    """

    object_type: bool
    pose: bool

    @property
    def width(self) -> int:
        """Features of an object."""
        return len(OBJECT_TYPES) * self.object_type + len(POSE) * self.pose

    def beside(
        self, features: Float[Tensor, "batch *time slots any"], inputs: Inputs
    ) -> Float[Tensor, "batch *time slots more"]:
        """Features of the objects, once or in every frame, with the declared ones behind them.

        Raises:
            ValueError: What is declared is not among the inputs.
        """
        if not self.width:
            return features
        named = {"object_type": inputs.object_type, "pose": inputs.pose}
        declared = [self._given(name, tensor) for name, tensor in named.items() if getattr(self, name)]
        behind = torch.cat(declared, dim=-1)
        if features.ndim > behind.ndim:
            behind = behind[:, None].expand(-1, features.shape[1], -1, -1)
        return torch.cat([features, behind], dim=-1)

    @staticmethod
    def _given(name: str, tensor: Tensor | None) -> Tensor:
        if tensor is None:
            raise ValueError(f"{name} is not among the inputs: a model needs {name}: true for it")
        return tensor
