"""Message passing against its equations written out, pair by pair."""

import torch
from torch import Tensor, nn

from cophy.models.affine import Affine
from cophy.models.convolution import GraphConvolution
from cophy.models.graph import Messages, neighbours


def edge_function(messages: Messages, receiver: Tensor, sender: Tensor) -> Tensor:
    """f as one MLP on the concatenated pair."""
    first = nn.Linear(2 * len(receiver), messages.receiver.out_features)
    first.weight.data = torch.cat([messages.receiver.weight, messages.sender.weight], dim=1)
    first.bias.data = messages.receiver.bias.data
    return messages.message(messages.edge(first(torch.cat([receiver, sender]))))


def written_out(graph: GraphConvolution, nodes: Tensor) -> Tensor:
    """Eq. 1 for one graph of present objects (K, D): f on concatenated pairs, means, then g."""

    def f(receiver: Tensor, sender: Tensor) -> Tensor:
        return edge_function(graph.messages, receiver, sender)

    count = len(nodes)
    zero = torch.zeros(graph.messages.message.out_features)
    received = [
        torch.stack([f(nodes[k], nodes[j]) for j in range(count) if j != k]).mean(dim=0) if count > 1 else zero
        for k in range(count)
    ]
    everything = torch.stack(received).mean(dim=0)
    return torch.stack([graph.node(torch.cat([nodes[k], received[k], everything])) for k in range(count)])


def test_convolutions_together_equal_the_equation() -> None:
    torch.manual_seed(0)
    graphs = [GraphConvolution(5, 16, edge_layers=4, node_layers=3) for _ in range(2)]
    readouts = [Affine(torch.randn(width, 16), torch.randn(width)) for width in (1, 7)]
    nodes = torch.randn(6, 3, 5)
    presence = torch.tensor([[1, 1, 1, 1, 1, 1], [0, 1, 0, 1, 1, 0], [0, 0, 1, 0, 0, 0]], dtype=torch.bool)
    position, constant = nodes.flatten(0, 1).split([3, 2], dim=1)
    results = GraphConvolution.together(list(zip(graphs, readouts, strict=True)), presence.t(), constant)(position)
    for graph, readout, result in zip(graphs, readouts, results, strict=True):
        for row, mask in enumerate(presence):
            expected = readout(written_out(graph, nodes[mask, row]))
            torch.testing.assert_close(result.unflatten(0, (6, 3))[mask, row], expected)


def test_f_and_g_have_the_layers_asked_for() -> None:
    graph = GraphConvolution(5, 16, edge_layers=4, node_layers=2)
    pairwise = [module for module in graph.messages.edge if isinstance(module, nn.Linear)]
    assert 1 + len(pairwise) + 1 == 4  # the split first layer, those on pairs, the one after the mean
    assert sum(isinstance(module, nn.Linear) for module in graph.node) == 2


def test_neighbours_within_the_radius_are_summed() -> None:
    torch.manual_seed(0)
    messages = Messages(5, 16, layers=3)
    nodes, position = torch.randn(1, 4, 5), torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [1.5, 0, 0], [9.0, 0, 0]]])
    presence = torch.ones(1, 4, dtype=torch.bool)
    received = messages(nodes, neighbours(presence, position, radius=1.2))[0]

    def total(receiver: int, *senders: int) -> Tensor:
        return sum((edge_function(messages, nodes[0, receiver], nodes[0, j]) for j in senders), torch.zeros(16))

    expected = torch.stack([total(0, 1), total(1, 0, 2), total(2, 1), total(3)])
    torch.testing.assert_close(received, expected)
    everyone = messages(nodes, neighbours(presence, position, radius=None))[0]
    torch.testing.assert_close(everyone[3], total(3, 0, 1, 2))
