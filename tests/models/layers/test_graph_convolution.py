"""Messages and graph convolution, pair by pair."""

import torch
from torch import Tensor, nn

from cophy.models.layers import GraphConvolution, PairwiseMLP, hear_mean_of_others, hear_sum_of_near, others
from tests.models.plain_loop import convolve, edge_function


def test_a_convolution_is_equation_1() -> None:
    torch.manual_seed(0)
    graph = GraphConvolution(5, 16, edge_layers=4, node_layers=3)
    nodes = torch.randn(3, 6, 5)
    presence = torch.tensor([[1, 1, 1, 1, 1, 1], [0, 1, 0, 1, 1, 0], [0, 0, 1, 0, 0, 0]], dtype=torch.bool)
    found = graph(nodes, hear_mean_of_others(presence, nodes.dtype))
    for row, mask in enumerate(presence):
        expected = convolve(graph, {k: nodes[row, k] for k in mask.nonzero().flatten().tolist()}, 6)
        for k, value in expected.items():
            torch.testing.assert_close(found[row, k], value)


def test_every_slot_meets_every_other_once_and_itself_never() -> None:
    slots = torch.arange(5)[None]
    met = others(slots)[0]
    for k in range(5):
        assert sorted(met[:, k].tolist()) == [j for j in range(5) if j != k]


def test_f_and_g_have_the_layers_asked_for() -> None:
    graph = GraphConvolution(5, 16, edge_layers=4, node_layers=2)
    further = [module for module in graph.f.further if isinstance(module, nn.Linear)]
    assert 1 + len(further) == 4  # the first is in two halves
    assert sum(isinstance(module, nn.Linear) for module in graph.g) == 2


def test_neighbours_within_the_radius_are_summed() -> None:
    torch.manual_seed(0)
    f = PairwiseMLP(5, 16, layers=3)
    nodes, position = torch.randn(1, 4, 5), torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [1.5, 0, 0], [9.0, 0, 0]]])
    presence = torch.ones(1, 4, dtype=torch.bool)

    def total(receiver: int, *senders: int) -> Tensor:
        return sum((edge_function(f, nodes[0, receiver], nodes[0, j]) for j in senders), torch.zeros(16))

    near = hear_sum_of_near(1.2, position, presence).sum_over_senders(f(nodes))[0]
    torch.testing.assert_close(near, torch.stack([total(0, 1), total(1, 0, 2), total(2, 1), total(3)]))
    everyone = hear_sum_of_near(None, position, presence).sum_over_senders(f(nodes))[0]
    torch.testing.assert_close(everyone[3], total(3, 0, 1, 2))
