"""Predictors by property."""

import pytest
import torch
from torch import Tensor, nn

from cophy.models.cophynet import CoPhyNet
from cophy.models.copying import CopyB, CopyC
from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch, Prediction
from tests.conftest import settings

ABLATIONS = ("full", "static_gating", "feedforward", "gt_confounders")


def cophynet(ablation: str = "full") -> CoPhyNet:
    torch.manual_seed(0)
    model = vars(settings("train", f"ablation={ablation}").model)
    arguments = {key: getattr(value, "value", value) for key, value in model.items() if key != "_target_"}
    return CoPhyNet(**arguments)


NETWORKS = {**{name: lambda name=name: cophynet(name) for name in ABLATIONS}, "copy_b": CopyB, "copy_c": CopyC}


@pytest.fixture(params=NETWORKS)
def network(request: pytest.FixtureRequest) -> nn.Module:
    return NETWORKS[request.param]()


def present(prediction: Prediction, batch: Batch) -> Tensor:
    return prediction.position * batch.presence[:, None, :, None]


def permuted(batch: Batch, order: list[int]) -> Batch:
    axes = {"observed": 2, "target": 2, "stable": 2}
    return Batch(
        **{
            name: tensor.index_select(axes.get(name, 1), torch.tensor(order))
            for name, tensor in batch._asdict().items()
        }
    )


def test_permuting_objects_permutes_the_prediction(network: nn.Module, tower_batch: Batch) -> None:
    order = [2, 0, 3, 1]
    expected = present(network(tower_batch), tower_batch).index_select(2, torch.tensor(order))
    changed = permuted(tower_batch, order)
    torch.testing.assert_close(present(network(changed), changed), expected, atol=1e-5, rtol=1e-4)


def test_absent_objects_change_nothing(network: nn.Module, tower_batch: Batch) -> None:
    absent_ab, absent_cd = ~tower_batch.observed_presence, ~tower_batch.presence
    noise = Batch(*(torch.randn(tensor.shape) if tensor.is_floating_point() else tensor for tensor in tower_batch))
    noisy = tower_batch._replace(
        observed=torch.where(absent_ab[:, None, :, None], noise.observed, tower_batch.observed),
        initial=torch.where(absent_cd[..., None], noise.initial, tower_batch.initial),
        confounders=torch.where(absent_ab[..., None], noise.confounders, tower_batch.confounders),
    )
    expected = present(network(tower_batch), tower_batch)
    torch.testing.assert_close(present(network(noisy), tower_batch), expected, atol=1e-5, rtol=1e-4)


def test_an_experiment_does_not_depend_on_its_batch(network: nn.Module, tower_batch: Batch) -> None:
    alone = Batch(*(tensor[5:6] for tensor in tower_batch))
    torch.testing.assert_close(
        present(network(alone), alone), present(network(tower_batch), tower_batch)[5:6], atol=1e-5, rtol=1e-4
    )


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_every_parameter_gets_a_gradient(ablation: str, tower_batch: Batch) -> None:
    network = cophynet(ablation)
    prediction = network(tower_batch)
    (position_loss(prediction, tower_batch) + stability_loss(prediction.stable_logit, tower_batch)).backward()
    without = [
        name for name, parameter in network.named_parameters() if parameter.grad is None or not parameter.grad.any()
    ]
    assert not without


def test_feedforward_cannot_tell_twins_apart(tower_batch: Batch) -> None:
    position = cophynet("feedforward")(tower_batch).position
    torch.testing.assert_close(position[::2], position[1::2])


@pytest.mark.parametrize("ablation", ["full", "static_gating"])
def test_counterfactual_models_read_ab(ablation: str, tower_batch: Batch) -> None:
    position = cophynet(ablation)(tower_batch).position
    assert (position[::2] - position[1::2]).abs().max() > 1e-6


def test_true_confounders_replace_ab(tower_batch: Batch) -> None:
    network = cophynet("gt_confounders")
    blind = tower_batch._replace(observed=torch.zeros_like(tower_batch.observed))
    torch.testing.assert_close(network(blind).position, network(tower_batch).position)


def test_static_gating_decides_once(tower_batch: Batch) -> None:
    assert cophynet("static_gating")(tower_batch).stable_logit.shape[1] == 1
    assert cophynet("full")(tower_batch).stable_logit.shape[1] == 29


def test_an_object_sure_to_be_stable_stays(tower_batch: Batch) -> None:
    network = cophynet()
    nn.init.zeros_(network.stable_logit.weight)
    nn.init.constant_(network.stable_logit.bias, 50.0)
    position = present(network(tower_batch), tower_batch)
    torch.testing.assert_close(position, present(CopyC()(tower_batch), tower_batch))


def test_copies_copy(tower_batch: Batch) -> None:
    torch.testing.assert_close(CopyC()(tower_batch).position[:, 17], tower_batch.initial)
    torch.testing.assert_close(CopyB()(tower_batch).position, tower_batch.observed[:, 1:])


def test_cophynet_overfits_one_batch(tower_batch: Batch) -> None:
    network, batch = cophynet(), Batch(*(tensor[:8] for tensor in tower_batch))
    optimizer = torch.optim.Adam(network.parameters(), lr=0.001)
    for _ in range(400):
        loss = position_loss(network(batch), batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.1 * position_loss(CopyC()(batch), batch)
