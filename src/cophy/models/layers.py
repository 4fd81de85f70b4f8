"""Layers that the models share: MLPs, graph convolution over all pairs of objects (paper Eq. 1), and packing of slots.

Pairs are stored as (batch, others, slots): for each receiving slot, one entry per other slot, in the order of `others`.
"""

from dataclasses import dataclass, fields
from enum import Enum
from itertools import pairwise
from typing import TypeVar

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.types import OBJECT_TYPES, POSE, SLOT_AXIS, Inputs, Prediction

MAX_LAYERS = 100  # ours: nothing so deep trains without shortcuts between layers

Option = TypeVar("Option", bound=Enum)


def check_at_least(minimum: int, **arguments: int) -> None:
    """Raise a CophyError that names the first argument below the minimum."""
    for name, value in arguments.items():
        if value < minimum:
            raise CophyError(f"model.{name}={value} must be at least {minimum}")


def check_layers(minimum: int, **arguments: int) -> None:
    """Raise a CophyError that names the first number of layers below the minimum or above MAX_LAYERS."""
    check_at_least(minimum, **arguments)
    for name, value in arguments.items():
        if value > MAX_LAYERS:
            raise CophyError(f"model.{name}={value} must be at most {MAX_LAYERS}")


def check_positive(**arguments: float | None) -> None:
    """Raise a CophyError that names the first argument that is neither positive nor None."""
    for name, value in arguments.items():
        if value is not None and not value > 0:
            raise CophyError(f"model.{name}={value} must be positive")


def parse_option(kind: type[Option], name: str, value: Option | str) -> Option:
    """Return the member of an enumeration that is this value or has it, or raise a CophyError that lists the valid ones."""
    if isinstance(value, kind):
        return value
    options = {option.value: option for option in kind}
    if value not in options:
        raise CophyError(f"model.{name}={value} must be one of {', '.join(options)}")
    return options[value]


def mlp(
    input_dim: int, hidden_dim: int, num_layers: int, output_dim: int | None = None, *, inplace: bool = False
) -> nn.Sequential:
    """Return linear layers with ReLU between them (paper, appendix).

    Args:
        hidden_dim: Width of every layer but the last.
        output_dim: Width of the last layer; None for `hidden_dim`.
        inplace: Whether ReLU overwrites its input: faster where the input of the MLP is a matrix, slower otherwise.
    """
    widths = [input_dim, *[hidden_dim] * (num_layers - 1), output_dim or hidden_dim]
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU(inplace)]
    return nn.Sequential(*layers[:-1])


def others(objects: Shaped[Tensor, "batch slots *features"]) -> Shaped[Tensor, "batch others slots *features"]:
    """Return for each slot the contents of the other slots: K - 1 copies, rotated by 1, 2, … K - 1.

    `others(x)[:, j, k]` is `x[:, (k - 1 - j) % K]` for j = 0 … K - 2. So every slot is paired with every other slot once
    and never with itself. Empty slots are included; a `Graph` gives them the weight 0.
    """
    return torch.stack([objects.roll(shift, dims=1) for shift in range(1, objects.shape[1])], dim=1)


def mirrored(pairs: Shaped[Tensor, "batch others slots *features"]) -> Shaped[Tensor, "batch others slots *features"]:
    """Return for each pair, in the order of `others`, what the other object has for the same pair."""
    reversed_pairs = pairs.flip(1).unbind(dim=1)
    return torch.stack([each.roll(shift, dims=1) for shift, each in enumerate(reversed_pairs, start=1)], dim=1)


@dataclass
class Graph:
    """Which objects are present, and with what weight they receive messages from each other.

    Attributes:
        present: 1 for a slot that holds an object, else 0.
        pair_weights: Weight of the message from each of the others (in the order of `others`); 0 for none.
        mean_weights: Weight of each slot in a mean over all objects.
    """

    present: Float[Tensor, "batch slots 1"]
    pair_weights: Float[Tensor, "batch others slots 1"]
    mean_weights: Float[Tensor, "batch slots 1"]

    def sum_over_senders(
        self, messages: Float[Tensor, "batch others slots hidden"]
    ) -> Float[Tensor, "batch slots hidden"]:
        """Return the weighted sum of the messages to each slot; zero for an object without senders."""
        return (self.pair_weights * messages).sum(dim=1)

    def mean_over_objects(self, objects: Float[Tensor, "batch slots hidden"]) -> Float[Tensor, "batch slots hidden"]:
        """Return the mean over all present objects, the same in every slot."""
        return (self.mean_weights * objects).sum(dim=1, keepdim=True).expand_as(objects)


def mean_graph(presence: Bool[Tensor, "batch slots"], dtype: torch.dtype) -> Graph:
    """Return the graph of Eq. 1: every present object receives the mean over all other present objects."""
    edges = (others(presence) & presence[:, None]).to(dtype)[..., None]
    return _graph(presence, edges / edges.sum(dim=1, keepdim=True).clamp(min=1))


def radius_graph(
    position: Float[Tensor, "batch slots 3"], presence: Bool[Tensor, "batch slots"], radius: float | None
) -> Graph:
    """Return the graph of IN and NPE: every present object receives the sum over all others within a radius.

    Args:
        position: Centres, metres.
        presence: Which slots hold an object.
        radius: Metres between two centres; None for all others, at any distance.
    """
    edges = others(presence) & presence[:, None]
    if radius is not None:
        edges = edges & ((others(position) - position[:, None]).square().sum(dim=-1) < radius**2)
    return _graph(presence, edges.to(position.dtype)[..., None])


def _graph(presence: Bool[Tensor, "batch slots"], pair_weights: Float[Tensor, "batch others slots 1"]) -> Graph:
    present = presence.to(pair_weights.dtype)[..., None]
    return Graph(present, pair_weights, present / present.sum(dim=1, keepdim=True).clamp(min=1))


class GraphConvolution(nn.Module):
    """Eq. 1: e^k = mean_{j≠k} f(o^k, o^j),  e = mean_k e^k,  õ^k = g(o^k, e^k, e). All objects share f and g.

    Here o^k is the input of object k: in CoPhyNet its position, and in the decoder also u^k.

    Args:
        input_dim: Features of an object, o.
        hidden_dim: Width of f and g, and features of õ.
        edge_layers: Linear layers of f.
        node_layers: Linear layers of g.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, edge_layers: int, node_layers: int) -> None:
        super().__init__()
        self.f = PairwiseMLP(input_dim, hidden_dim, layers=edge_layers)
        self.g = mlp(input_dim + 2 * hidden_dim, hidden_dim, node_layers)

    def forward(self, nodes: Float[Tensor, "batch slots input"], graph: Graph) -> Float[Tensor, "batch slots hidden"]:
        """Return õ for every object."""
        messages = self.f(nodes)  # f(o^k, o^j)
        received = graph.sum_over_senders(messages)  # e^k; the weights of a mean are 1 over the number of senders
        mean = graph.mean_over_objects(received)  # e
        return self.g(torch.cat([nodes, received, mean], dim=-1))


class PairwiseMLP(nn.Module):
    """f(o^k, o^j): an MLP on the concatenation of a receiver and a sender, for all pairs at once.

    Optionally f(o^k, o^j, r^kj) with features r of the pair. The first layer is linear, so it is computed in parts:
    those of receivers and senders once per object instead of once per pair.

    Args:
        input_dim: Features of an object.
        hidden_dim: Width of all layers, and features of a message.
        layers: Linear layers, at least 2, with ReLU between them.
        relation_dim: Features of a pair; 0 for none.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, relation_dim: int = 0) -> None:
        super().__init__()
        self.receiver = nn.Linear(input_dim, hidden_dim)
        self.sender = nn.Linear(input_dim, hidden_dim, bias=False)
        self.relation = nn.Linear(relation_dim, hidden_dim, bias=False) if relation_dim else None
        self.further = mlp(hidden_dim, hidden_dim, layers - 1, inplace=True)

    def forward(
        self,
        nodes: Float[Tensor, "batch slots input"],
        relations: Float[Tensor, "batch others slots relation"] | None = None,
    ) -> Float[Tensor, "batch others slots hidden"]:
        """Return the message to each slot from each of the others."""
        first = self.receiver(nodes)[:, None] + others(self.sender(nodes))
        if self.relation is not None:
            first = first + self.relation(relations)
        # one row per pair: with more dimensions, PyTorch would copy what ReLU changes in place
        return self.further(torch.relu(first).flatten(0, 2)).view_as(first)


class SlotMLP(nn.Module):
    """An MLP over the concatenated slots. It depends on their number and order, so it is not equivariant.

    Args:
        input_dim: Features of an object.
        hidden_dim: Features of an object in the result; the MLP is `num_slots` times as wide.
        layers: Linear layers.
        num_slots: Slots of every batch, including empty ones.
    """

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, num_slots: int) -> None:
        super().__init__()
        self.network = mlp(num_slots * input_dim, num_slots * hidden_dim, layers)

    def forward(self, nodes: Float[Tensor, "batch slots input"], graph: Graph) -> Float[Tensor, "batch slots hidden"]:
        """Return new features for every slot; empty slots count as zero."""
        present = nodes * graph.present
        return self.network(present.flatten(1)).unflatten(1, (nodes.shape[1], -1))


MIN_SLOTS = 2  # so that there is always another slot to pair with


def pack(inputs: Inputs) -> tuple[Inputs, Int[Tensor, "batch packed"]]:
    """Move the objects of every experiment to the front, and drop slots that no experiment needs.

    Four balls fill 4 of 9 slots, and the cost of pairs is quadratic.

    Returns:
        The packed inputs, and the slot that each object came from.
    """
    used = inputs.observed_presence | inputs.presence
    width = max(MIN_SLOTS, int(used.sum(dim=1).max()))
    slots = used.float().argsort(dim=1, descending=True, stable=True)[:, :width]
    packed = {
        name: tensor.gather(axis, _expand(slots, tensor, axis)) for name, tensor, axis in _tensors_with_slots(inputs)
    }
    return Inputs(**packed), slots


def unpack(prediction: Prediction, slots: Int[Tensor, "batch packed"], num_slots: int) -> Prediction:
    """Put every object back into its slot; empty slots are zero.

    Args:
        prediction: Prediction for packed inputs.
        slots: The slot that each object came from, see `pack`.
        num_slots: Number of slots before packing.
    """
    unpacked = {}
    for name, tensor, axis in _tensors_with_slots(prediction):
        empty = tensor.new_zeros([*tensor.shape[:axis], num_slots, *tensor.shape[axis + 1 :]])
        unpacked[name] = empty.scatter(axis, _expand(slots, tensor, axis), tensor)
    return Prediction(**unpacked)


def _tensors_with_slots(batch: Inputs | Prediction) -> list[tuple[str, Tensor, int]]:
    """Return name, value and slot axis of every field that is not None."""
    values = [(field.name, getattr(batch, field.name)) for field in fields(batch)]
    return [(name, value, SLOT_AXIS.get(name, 1)) for name, value in values if value is not None]


def _expand(slots: Int[Tensor, "batch packed"], tensor: Tensor, axis: int) -> Tensor:
    """Return slot indices for `axis` of a tensor, repeated along all other axes."""
    shape = [len(slots), *[1] * (tensor.ndim - 1)]
    shape[axis] = slots.shape[1]
    return slots.view(shape).expand(*tensor.shape[:axis], slots.shape[1], *tensor.shape[axis + 1 :])


@dataclass(frozen=True)
class Appearance:
    """Optional inputs that describe how objects look at t = 0. The paper's models see positions alone.

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

    def concatenate_to(
        self, features: Float[Tensor, "batch *time slots any"], inputs: Inputs
    ) -> Float[Tensor, "batch *time slots more"]:
        """Append the optional inputs to features of the objects, in every frame if the features have a time axis.

        Raises:
            ValueError: One of them is not among the inputs.
        """
        if not self.width:
            return features
        columns = []
        for name, tensor in (("object_type", inputs.object_type), ("pose", inputs.pose)):
            if getattr(self, name):
                if tensor is None:
                    raise ValueError(f"{name} is not among the inputs: a model needs {name}: true for it")
                columns.append(tensor)
        appended = torch.cat(columns, dim=-1)
        if features.ndim > appended.ndim:
            appended = appended[:, None].expand(-1, features.shape[1], -1, -1)
        return torch.cat([features, appended], dim=-1)
