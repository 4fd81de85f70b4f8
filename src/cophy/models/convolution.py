"""Graph convolution over all pairs of present objects (paper Eq. 1).

e^k = mean_j f(o^k, o^j), j ≠ k        e = mean_k e^k        õ^k = g(o^k, e^k, e)
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from cophy.models.affine import Affine
from cophy.models.graph import Messages
from cophy.models.interactions import Step
from cophy.models.mlp import mlp


class GraphConvolution(nn.Module):
    """f (`messages`) and g (`node`), shared by all objects."""

    def __init__(self, input_dim: int, hidden_dim: int, *, edge_layers: int, node_layers: int) -> None:
        super().__init__()
        self.messages = Messages(input_dim, hidden_dim, layers=edge_layers)
        self.node = mlp(input_dim + 2 * hidden_dim, hidden_dim, node_layers)

    @staticmethod
    def together(parts: Sequence[tuple["GraphConvolution", Affine]], presence: Tensor, constant: Tensor) -> Step:
        """See `Interactions`. Objects receive from those present, and e is the mean over these."""
        return _Together(parts, presence, constant)


class _Together:
    """G convolutions over the same N graphs. Axes: K slots, first; H hidden; pairs are K-1 senders of K receivers.

    Saves work without changing the function: the first layer of f is the sum of a receiver's and a sender's half, that of g
    of an object's own part and of what it receives, and the constant's share of all these is computed once. The last layer
    of f is applied to the mean of the messages, and so is one with the first of g; the last of g is one with the readout.
    """

    def __init__(self, parts: Sequence[tuple[GraphConvolution, Affine]], presence: Tensor, constant: Tensor) -> None:
        messages, nodes = [module.messages for module, _ in parts], [_linear(module.node) for module, _ in parts]
        hidden_dim, input_dim = messages[0].receiver.weight.shape
        slots, graphs = presence.shape
        self.shape = slots, graphs, len(parts), hidden_dim
        self.edge = _side_by_side([_linear(m.edge) for m in messages])
        self.node = _side_by_side([layers[1:-1] for layers in nodes])
        self.readouts = [readout.after(layers[-1]) for (_, readout), layers in zip(parts, nodes, strict=True)]

        numbers = torch.arange(slots, device=presence.device)
        self.senders = (numbers + numbers[1:, None]) % slots  # (K-1, K): of every receiver, all others
        self.pairs = (numbers - numbers[1:, None]) % slots + slots * numbers[:-1, None]  # (K-1, K): of every sender
        present = presence.to(constant.dtype)
        sent = present[self.senders] * present
        self.mean = (sent / sent.sum(dim=0).clamp(min=1)).flatten(1)[..., None]  # over the senders of a receiver
        self.mean_of_all = (present / present.sum(dim=0).clamp(min=1))[..., None]
        receives = sent.any(dim=0).to(constant.dtype)[..., None]  # (K, N, 1): those alone receive nothing

        first = torch.stack([layers[0].weight for layers in nodes])
        own, *of_received = first.split_with_sizes([input_dim, hidden_dim, hidden_dim], dim=2)
        last = torch.stack([m.message.weight for m in messages])
        last_bias = torch.stack([m.message.bias for m in messages])[..., None]
        self.received, self.received_by_all = ((weight @ last).transpose(1, 2) for weight in of_received)  # (G, H, H)
        bias, bias_of_all = ((weight @ last_bias).flatten() for weight in of_received)
        share = (receives * self.mean_of_all).sum(dim=0)
        own_bias = torch.cat([layers[0].bias for layers in nodes]) + receives * bias + share * bias_of_all
        receiver_bias = torch.cat([m.receiver.bias for m in messages]).expand_as(own_bias)
        biases = torch.stack([receiver_bias, torch.zeros_like(own_bias), own_bias], dim=2).flatten(0, 1).flatten(1)
        halves = [*(m.receiver.weight for m in messages), *(m.sender.weight for m in messages), *own.unbind()]
        self.position, of_constant = torch.cat(halves).t().contiguous().split_with_sizes([3, input_dim - 3])
        self.constant = torch.addmm(biases, constant, of_constant)  # (K·N, 3·G·H)

    def __call__(self, position: Tensor) -> list[Tensor]:
        """(K·N, 3) -> one readout (K·N, ·) per convolution."""
        slots, graphs, count, hidden_dim = self.shape
        first = torch.addmm(self.constant, position, self.position).view(slots, graphs, 3, count, hidden_dim)
        receiver, sender, own = first.unbind(dim=2)
        pairs: Tensor = _Pairs.apply(receiver, sender, self.senders, self.pairs)  # type: ignore[no-untyped-call]
        edges = pairs.view(-1, count, hidden_dim).transpose(0, 1)
        for weight, bias in self.edge:
            edges = torch.baddbmm(bias, edges, weight).relu_()
        received = (edges.reshape(count, slots - 1, slots * graphs, hidden_dim) * self.mean).sum(dim=1)
        of_all = (received.view(count, slots, graphs, hidden_dim) * self.mean_of_all).sum(dim=1)
        everything = torch.bmm(of_all, self.received_by_all).unsqueeze(1)
        nodes = torch.baddbmm(own.flatten(0, 1).transpose(0, 1), received, self.received)
        nodes = (nodes.view(count, slots, graphs, hidden_dim) + everything).relu_().view(count, -1, hidden_dim)
        for weight, bias in self.node:
            nodes = torch.baddbmm(bias, nodes, weight).relu_()
        return [readout(features) for readout, features in zip(self.readouts, nodes.unbind(), strict=True)]


class _Pairs(torch.autograd.Function):
    """ReLU of the sum of a receiver's and a sender's half, (K, ...) each -> (K·(K-1), ...).

    senders: (K-1, K), of every receiver; pairs: (K-1, K), those of every sender, which spare the derivative a scatter.
    """

    @staticmethod
    def forward(ctx: Any, receiver: Tensor, sender: Tensor, senders: Tensor, pairs: Tensor) -> Tensor:
        summed = sender.index_select(0, senders.flatten())
        summed.view(*senders.shape, *sender.shape[1:]).add_(receiver)
        ctx.save_for_backward(summed.relu_(), pairs)
        return summed

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None, None]:
        summed, pairs = ctx.saved_tensors
        grad = torch.ops.aten.threshold_backward(grad, summed, 0)
        by_receiver, by_sender = grad, grad.index_select(0, pairs.flatten())
        shape = *pairs.shape, *grad.shape[1:]
        return by_receiver.view(shape).sum(dim=0), by_sender.view(shape).sum(dim=0), None, None


def _linear(network: nn.Sequential) -> list[nn.Linear]:
    return [layer for layer in network if isinstance(layer, nn.Linear)]


def _side_by_side(networks: list[list[nn.Linear]]) -> list[tuple[Tensor, Tensor]]:
    """Of every layer, the weights (G, input, output) and biases (G, 1, output)."""
    return [
        (torch.stack([one.weight.t() for one in layer]), torch.stack([one.bias for one in layer])[:, None])
        for layer in zip(*networks, strict=True)
    ]
