"""Graph convolution and messages pair by pair; packing of slots."""

import pytest
import torch
from torch import Tensor, nn

from cophy.models.layers import GraphConvolution, PairwiseMLP, mean_graph, mirrored, others, pack, radius_graph, unpack
from cophy.types import Prediction
from tests.models.networks import random_batch
from tests.models.plain_loop import convolve, edge_function


def test_a_convolution_is_equation_1() -> None:
    torch.manual_seed(0)
    convolution = GraphConvolution(5, 16, edge_layers=4, node_layers=3)
    nodes = torch.randn(3, 6, 5)
    presence = torch.tensor([[1, 1, 1, 1, 1, 1], [0, 1, 0, 1, 1, 0], [0, 0, 1, 0, 0, 0]], dtype=torch.bool)
    result = convolution(nodes, mean_graph(presence, nodes.dtype))
    for row, mask in enumerate(presence):
        expected = convolve(convolution, {k: nodes[row, k] for k in mask.nonzero().flatten().tolist()}, 6)
        for k, value in expected.items():
            torch.testing.assert_close(result[row, k], value)


def test_every_slot_is_paired_with_every_other_once_and_never_with_itself() -> None:
    pairs = others(torch.arange(5)[None])[0]
    for k in range(5):
        assert sorted(pairs[:, k].tolist()) == [j for j in range(5) if j != k]


@pytest.mark.parametrize("count", [2, 5])
def test_mirrored_pairs_exchange_their_objects(count: int) -> None:
    objects = torch.randn(3, count, 2)
    own, other = objects[:, None].expand(-1, count - 1, -1, -1), others(objects)
    assert torch.equal(mirrored(own - 2 * other), other - 2 * own)


def test_f_and_g_have_the_configured_numbers_of_layers() -> None:
    convolution = GraphConvolution(5, 16, edge_layers=4, node_layers=2)
    further = [module for module in convolution.f.further if isinstance(module, nn.Linear)]
    assert 1 + len(further) == 4  # the first layer is in two halves
    assert sum(isinstance(module, nn.Linear) for module in convolution.g) == 2


def test_neighbours_within_the_radius_are_summed() -> None:
    torch.manual_seed(0)
    f = PairwiseMLP(5, 16, layers=3)
    nodes, position = torch.randn(1, 4, 5), torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [1.5, 0, 0], [9.0, 0, 0]]])
    presence = torch.ones(1, 4, dtype=torch.bool)

    def total(receiver: int, *senders: int) -> Tensor:
        return sum((edge_function(f, nodes[0, receiver], nodes[0, j]) for j in senders), torch.zeros(16))

    near = radius_graph(position, presence, 1.2).sum_over_senders(f(nodes))[0]
    torch.testing.assert_close(near, torch.stack([total(0, 1), total(1, 0, 2), total(2, 1), total(3)]))
    everyone = radius_graph(position, presence, None).sum_over_senders(f(nodes))[0]
    torch.testing.assert_close(everyone[3], total(3, 0, 1, 2))


def test_features_of_a_pair_are_a_third_part_of_the_first_layer() -> None:
    torch.manual_seed(0)
    f = PairwiseMLP(5, 16, layers=2, relation_dim=3)
    nodes, relations = torch.randn(2, 4, 5), torch.randn(2, 3, 4, 3)
    first = f.receiver(nodes[1, 2]) + f.sender(others(nodes)[1, 0, 2]) + f.relation(relations[1, 0, 2])
    torch.testing.assert_close(f(nodes, relations)[1, 0, 2], f.further(first.relu()))


def test_packing_moves_objects_to_the_front_in_their_order() -> None:
    inputs = random_batch(9, [2, 4]).inputs
    packed, slots = pack(inputs)
    assert packed.presence.shape == (2, 4)
    for n in range(2):
        used = (inputs.observed_presence | inputs.presence)[n].nonzero().flatten()
        assert slots[n, : len(used)].tolist() == used.tolist()
        torch.testing.assert_close(packed.initial[n, : len(used)], inputs.initial[n, used])
        torch.testing.assert_close(packed.observed[n, :, : len(used)], inputs.observed[n][:, used])


def test_unpacking_puts_every_object_back() -> None:
    inputs = random_batch(9, [3, 4, 2]).inputs
    packed, slots = pack(inputs)
    prediction = Prediction(packed.observed[:, 1:], packed.observed_stable.float(), packed.confounders)
    unpacked = unpack(prediction, slots, 9)
    torch.testing.assert_close(unpacked.position, inputs.observed[:, 1:])
    present = inputs.observed_presence
    torch.testing.assert_close(
        unpacked.stable_logit * present[:, None], inputs.observed_stable * present[:, None].float()
    )
    torch.testing.assert_close(unpacked.confounder_estimate, inputs.confounders * present[..., None])


@pytest.mark.parametrize("num_objects", [[0], [1]])
def test_at_least_two_slots_remain(num_objects: list[int]) -> None:
    packed, _ = pack(random_batch(4, num_objects).inputs)
    assert packed.initial.shape == (1, 2, 3)
