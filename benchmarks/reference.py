"""CoPhyNet written plainly: one object and one frame at a time, over all slots. What the fast form is held against.

The equations of the paper's Sec. 4 as they stand, with the weights of a `CoPhyNet` as conf/model/cophynet.yaml has it:
f on concatenated pairs, masked means, g, recurrent networks per object. tests/models/test_reference.py holds the two equal.
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import linear

from cophy.models.convolution import GraphConvolution
from cophy.models.cophynet import CoPhyNet
from cophy.models.decoders import gate
from cophy.models.graph import Messages
from cophy.types import Batch, Prediction


def predict(network: CoPhyNet, batch: Batch) -> Prediction:
    """What `network(batch)` is; slots without an object hold values that mean nothing."""
    confounders = estimate(network, batch)
    decoder, slots = network.decoder, range(batch.initial.shape[1])
    position = list(batch.initial.unbind(1))
    hidden = [[torch.zeros_like(u) for _ in decoder.gru] for u in confounders]
    positions, logits = [], []
    for _ in range(batch.observed.shape[1] - 1):
        nodes = [torch.cat([position[k], confounders[k]], dim=-1) for k in slots]
        stability = convolve(decoder.stability, nodes, batch.presence)
        dynamics = convolve(decoder.dynamics, nodes, batch.presence)
        logit = [decoder.stable_logit(features) for features in stability]
        for k in slots:
            features = dynamics[k]
            for layer, cell in enumerate(decoder.gru):
                hidden[k][layer] = features = cell(features, hidden[k][layer])
            position[k] = position[k] + gate(logit[k], decoder.temperature) * decoder.displacement(features)
        positions.append(torch.stack(position, dim=1))
        logits.append(torch.cat(logit, dim=1))
    return Prediction(torch.stack(positions, dim=1), torch.stack(logits, dim=1), torch.stack(confounders, dim=1))


def estimate(network: CoPhyNet, batch: Batch) -> list[Tensor]:
    """U of every slot, (B, hidden) each."""
    frames = [
        convolve(network.estimator.interactions, list(frame.unbind(1)), batch.observed_presence)
        for frame in batch.observed.unbind(1)
    ]
    return [network.estimator.gru(torch.stack(sequence))[0][-1] for sequence in zip(*frames, strict=True)]


def convolve(graph: GraphConvolution, nodes: list[Tensor], presence: Tensor) -> list[Tensor]:
    """Eq. 1 for nodes (B, D) of every slot, present where `presence` (B, K) says so."""
    f, slots, present = edge_function(graph.messages), range(len(nodes)), presence.to(nodes[0].dtype)
    received = []
    for k in slots:
        others = [j for j in slots if j != k]
        senders = torch.stack([nodes[j] for j in others], dim=1)
        pairs = torch.cat([nodes[k][:, None].expand_as(senders), senders], dim=-1)
        received.append(mean(f(pairs), present[:, others]) * present[:, k : k + 1])
    everything = mean(torch.stack(received, dim=1), present)
    return [graph.node(torch.cat([nodes[k], received[k], everything], dim=-1)) for k in slots]


def edge_function(messages: Messages) -> Callable[[Tensor], Tensor]:
    """f as one MLP on [receiver, sender]."""
    first = torch.cat([messages.receiver.weight, messages.sender.weight], dim=1)
    return lambda pairs: messages.message(messages.edge(linear(pairs, first, messages.receiver.bias)))


def mean(values: Tensor, present: Tensor) -> Tensor:
    """(B, K, H) -> (B, H) over the present ones; zero if there are none."""
    return (values * present[..., None]).sum(dim=1) / present.sum(dim=1, keepdim=True).clamp(min=1)
