"""The graph convolution against Eq. 1 written out, pair by pair."""

import torch
from torch import Tensor, nn

from cophy.models.graph import GraphConvolution, fully_connected


def written_out(graph: GraphConvolution, nodes: Tensor) -> Tensor:
    """Eq. 1 for one graph of present objects (K, D): f on concatenated pairs, means, then g."""
    first = nn.Linear(2 * nodes.shape[1], graph.receiver.out_features)
    first.weight.data = torch.cat([graph.receiver.weight, graph.sender.weight], dim=1)
    first.bias.data = graph.receiver.bias.data

    def f(receiver: Tensor, sender: Tensor) -> Tensor:
        return graph.message(graph.edge(first(torch.cat([receiver, sender]))))

    count = len(nodes)
    zero = torch.zeros(graph.message.out_features)
    received = [
        torch.stack([f(nodes[k], nodes[j]) for j in range(count) if j != k]).mean(dim=0) if count > 1 else zero
        for k in range(count)
    ]
    everything = torch.stack(received).mean(dim=0)
    return torch.stack([graph.node(torch.cat([nodes[k], received[k], everything])) for k in range(count)])


def test_the_fast_form_equals_the_equation() -> None:
    torch.manual_seed(0)
    graph = GraphConvolution(5, 16, edge_layers=4, node_layers=2)
    nodes = torch.randn(3, 6, 5)
    presence = torch.tensor([[1, 1, 1, 1, 1, 1], [0, 1, 0, 1, 1, 0], [0, 0, 1, 0, 0, 0]], dtype=torch.bool)
    result = graph(nodes, fully_connected(presence))
    for row, mask in enumerate(presence):
        torch.testing.assert_close(result[row, mask], written_out(graph, nodes[row, mask]))


def test_the_edge_function_has_the_layers_asked_for() -> None:
    graph = GraphConvolution(5, 16, edge_layers=4, node_layers=2)
    pairwise = [module for module in graph.edge if isinstance(module, nn.Linear)]
    assert 1 + len(pairwise) + 1 == 4  # the split first layer, those on pairs, the one after the mean
    assert sum(isinstance(module, nn.Linear) for module in graph.node) == 2
