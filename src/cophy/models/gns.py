"""GNS, the graph network simulator of Sanchez-Gonzalez et al. (2020), given CoPhyNet's estimate U of AB. It is not in the paper.

    AB --GCN per frame, GRU over time--> u                              (as CoPhyNet)
    node k: [last velocities, height, distances to walls, u]  --encode--> x^k
    edge jk: [offset, distance]                                --encode--> e^jk
    M times, with weights of their own: m = MLP(e, x^k, x^j);  x' = x + MLP(x, Σ_j m^jk);  e' = e + m
    x --decode--> acceleration a;  v' = v + a;  o' = o + v'            (semi-implicit Euler, one step per frame)

All MLPs but the decoder end in a LayerNorm. As published: no absolute position on the floor, weights that differ between
steps of message passing, sums of messages, residual nodes and edges. Unlike it: all objects are connected; the rollout is
trained as a whole, since C shows no velocity (U has to tell it), so noise is that of the inputs (training.position_noise).
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.contacts import OFFSET_DIM, offsets
from cophy.models.cophynet import ConfounderEstimator
from cophy.models.layers import (
    Appearance,
    Graph,
    GraphConvolution,
    check_at_least,
    check_positive,
    mlp,
    others,
    pack,
    radius_graph,
    unpack,
)
from cophy.models.rollout import share_within
from cophy.types import Inputs, Prediction

NEAR_WALL_M = 1.0  # ours: distances to walls are clipped there; a ball touches at half of it
INITIAL_ACCELERATION_SCALE = 0.01  # of the decoder's last weights: before training, objects nearly stay


def encoder(input_dim: int, hidden_dim: int) -> nn.Sequential:
    """Return an MLP with two hidden layers and a LayerNorm."""
    return nn.Sequential(mlp(input_dim, hidden_dim, 3), nn.LayerNorm(hidden_dim))


class MessagePassing(nn.Module):
    """One step of the processor."""

    def __init__(self, hidden_dim: int) -> None:
        """Build both MLPs."""
        super().__init__()
        self.edge, self.node = encoder(3 * hidden_dim, hidden_dim), encoder(2 * hidden_dim, hidden_dim)

    def forward(
        self, nodes: Float[Tensor, "batch slots h"], edges: Float[Tensor, "batch others slots h"], graph: Graph
    ) -> tuple[Float[Tensor, "batch slots h"], Float[Tensor, "batch others slots h"]]:
        """Return new nodes and edges."""
        receivers = nodes[:, None].expand_as(edges)
        messages = self.edge(torch.cat([edges, receivers, others(nodes)], dim=-1))
        return nodes + self.node(torch.cat([nodes, graph.sum_over_senders(messages)], dim=-1)), edges + messages


class GNS(nn.Module):
    """Estimates U from AB as CoPhyNet does, and simulates D from C and U.

    Args:
        hidden_dim: Width of nodes and edges.
        message_steps: M, steps of message passing.
        num_velocities: Last velocities that a node has; those before C are 0.
        max_step: Largest displacement of an object in a step, metres.
        estimate_dim: Width of U and of the layers that estimate it.
        gru_layers, edge_layers, node_layers: Of the estimator, see `CoPhyNet`.
        arena_half_width: Distance from the origin to each of four walls, metres; None without walls.
        object_type: Whether the model sees the type of each object.
        pose: Whether the model sees the orientation of each object at t = 0.

    Raises:
        CophyError: An argument is out of its range.

    Attributes:
        estimate_dim: Width of U.
    """

    def __init__(
        self,
        *,
        hidden_dim: int,
        message_steps: int,
        num_velocities: int,
        max_step: float,
        estimate_dim: int,
        gru_layers: int,
        edge_layers: int,
        node_layers: int,
        arena_half_width: float | None,
        object_type: bool = False,
        pose: bool = False,
    ) -> None:
        super().__init__()
        sizes = {"hidden_dim": hidden_dim, "message_steps": message_steps, "num_velocities": num_velocities}
        check_at_least(1, **sizes, estimate_dim=estimate_dim, gru_layers=gru_layers)
        check_at_least(2, edge_layers=edge_layers, node_layers=node_layers)
        check_positive(arena_half_width=arena_half_width, max_step=max_step)
        self.estimate_dim, self.num_velocities, self.arena_half_width = estimate_dim, num_velocities, arena_half_width
        self.max_step = max_step
        self.appearance = Appearance(object_type, pose)
        convolution = GraphConvolution(
            3 + self.appearance.width, estimate_dim, edge_layers=edge_layers, node_layers=node_layers
        )
        self.estimator = ConfounderEstimator(convolution, hidden_dim=estimate_dim, gru_layers=gru_layers)
        node_dim = 3 * num_velocities + 1 + 4 * (arena_half_width is not None) + estimate_dim + self.appearance.width
        self.encode_node, self.encode_edge = encoder(node_dim, hidden_dim), encoder(OFFSET_DIM, hidden_dim)
        self.processor = nn.ModuleList(MessagePassing(hidden_dim) for _ in range(message_steps))
        self.decode = mlp(hidden_dim, hidden_dim, 3, output_dim=3)
        last = self.decode[-1]
        assert isinstance(last, nn.Linear)
        nn.init.normal_(last.weight, std=INITIAL_ACCELERATION_SCALE / hidden_dim**0.5)
        nn.init.zeros_(last.bias)

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        observed = self.appearance.concatenate_to(inputs.observed, inputs)
        u = self.estimator(observed, inputs.observed_presence)
        constant = self.appearance.concatenate_to(u, inputs)
        position = inputs.initial
        velocities = [torch.zeros_like(position)] * self.num_velocities
        graph = radius_graph(position, inputs.presence, None)
        positions = []
        for _ in range(inputs.num_steps):
            velocity = velocities[-1] + self._accelerate(position, velocities, constant, graph)
            velocity = share_within(self.max_step, velocity) * velocity
            velocities = [*velocities[1:], velocity]
            position = position + velocity
            positions.append(position)
        return Prediction(torch.stack(positions, dim=1), confounder_estimate=u)

    def _accelerate(
        self,
        position: Float[Tensor, "batch slots 3"],
        velocities: list[Float[Tensor, "batch slots 3"]],
        constant: Float[Tensor, "batch slots any"],
        graph: Graph,
    ) -> Float[Tensor, "batch slots 3"]:
        """Return the acceleration in metres per frame²."""
        features = [*velocities, position[..., 2:], constant]
        if self.arena_half_width is not None:
            xy = position[..., :2]
            walls = torch.cat([self.arena_half_width - xy, self.arena_half_width + xy], dim=-1)
            features.append(walls.clamp(max=NEAR_WALL_M))
        nodes = self.encode_node(torch.cat(features, dim=-1))
        edges = self.encode_edge(offsets(position))
        for step in self.processor:
            nodes, edges = step(nodes, edges, graph)
        return self.decode(nodes)
