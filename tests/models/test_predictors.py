"""Predictors by property."""

from operator import itemgetter

import pytest
import torch
from omegaconf import OmegaConf
from torch import Tensor, nn

from cophy.models.copying import CopyB, CopyC
from cophy.training.losses import position_loss, stability_loss
from cophy.training.run import build_network
from cophy.types import Batch, Prediction, map_fields
from tests.conftest import composed

ABLATIONS = ("full", "static_gating", "mlp", "single_step", "feedforward", "gt_confounders")
BASELINES = ("in", "npe", "in gt_confounders", "copy_b", "copy_c")


def build(choice: str) -> nn.Module:
    """The network of "model ablation" as conf/ has it, or of a CoPhyNet ablation."""
    model, _, ablation = f"cophynet {choice}".partition(" ") if choice in ABLATIONS else choice.partition(" ")
    config = composed("train", f"model={model}", f"ablation={ablation or 'full'}")
    torch.manual_seed(0)
    return build_network(OmegaConf.to_container(config.model, resolve=True, enum_to_str=True))


@pytest.fixture(params=[*(name for name in ABLATIONS if name != "mlp"), *BASELINES])
def network(request: pytest.FixtureRequest) -> nn.Module:
    return build(request.param)


@pytest.fixture(params=[*ABLATIONS, *BASELINES])
def any_network(request: pytest.FixtureRequest) -> nn.Module:
    return build(request.param)


def present(prediction: Prediction, batch: Batch) -> Tensor:
    return prediction.position * batch.presence[:, None, :, None]


def permuted(batch: Batch, order: list[int]) -> Batch:
    axes = {"observed": 2, "observed_stable": 2, "target": 2, "stable": 2}
    return Batch(
        **{
            name: tensor.index_select(axes.get(name, 1), torch.tensor(order))
            for name, tensor in batch._asdict().items()
            if tensor is not None
        }
    )


def test_permuting_objects_permutes_the_prediction(network: nn.Module, tower_batch: Batch) -> None:
    order = [2, 0, 3, 1]
    expected = present(network(tower_batch), tower_batch).index_select(2, torch.tensor(order))
    changed = permuted(tower_batch, order)
    torch.testing.assert_close(present(network(changed), changed), expected, atol=1e-5, rtol=1e-4)


def test_an_mlp_over_slots_is_the_one_that_is_not_equivariant(tower_batch: Batch) -> None:
    network, order = build("mlp"), [2, 0, 3, 1]
    expected = present(network(tower_batch), tower_batch).index_select(2, torch.tensor(order))
    changed = permuted(tower_batch, order)
    assert (present(network(changed), changed) - expected).abs().max() > 0.01


def test_absent_objects_change_nothing(any_network: nn.Module, tower_batch: Batch) -> None:
    absent_ab, absent_cd = ~tower_batch.observed_presence, ~tower_batch.presence
    noise = map_fields(lambda t: torch.randn(t.shape) if t.is_floating_point() else t, tower_batch)
    noisy = tower_batch._replace(
        observed=torch.where(absent_ab[:, None, :, None], noise.observed, tower_batch.observed),
        initial=torch.where(absent_cd[..., None], noise.initial, tower_batch.initial),
        confounders=torch.where(absent_ab[..., None], noise.confounders, tower_batch.confounders),
    )
    expected = present(any_network(tower_batch), tower_batch)
    torch.testing.assert_close(present(any_network(noisy), tower_batch), expected, atol=1e-5, rtol=1e-4)


def test_an_experiment_does_not_depend_on_its_batch(any_network: nn.Module, tower_batch: Batch) -> None:
    alone = map_fields(itemgetter(slice(5, 6)), tower_batch)
    torch.testing.assert_close(
        present(any_network(alone), alone), present(any_network(tower_batch), tower_batch)[5:6], atol=1e-5, rtol=1e-4
    )


@pytest.mark.parametrize("choice", [*ABLATIONS, "in", "npe", "in gt_confounders"])
def test_every_parameter_gets_a_gradient(choice: str, tower_batch: Batch) -> None:
    network = build(choice)
    prediction = network(tower_batch)
    loss = position_loss(prediction, tower_batch)
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, tower_batch)
    loss.backward()
    without = [
        name for name, parameter in network.named_parameters() if parameter.grad is None or not parameter.grad.any()
    ]
    assert not without


@pytest.mark.parametrize("choice", ["feedforward", "in", "npe"])
def test_what_never_sees_ab_cannot_tell_twins_apart(choice: str, tower_batch: Batch) -> None:
    position = build(choice)(tower_batch).position
    torch.testing.assert_close(position[::2], position[1::2])


@pytest.mark.parametrize("ablation", ["full", "static_gating", "mlp", "single_step"])
def test_counterfactual_models_read_ab(ablation: str, tower_batch: Batch) -> None:
    position = build(ablation)(tower_batch).position
    assert (position[::2] - position[1::2]).abs().max() > 1e-6


@pytest.mark.parametrize("choice", ["gt_confounders", "in gt_confounders"])
def test_true_confounders_replace_ab(choice: str, tower_batch: Batch) -> None:
    network = build(choice)
    blind = tower_batch._replace(observed=torch.zeros_like(tower_batch.observed))
    torch.testing.assert_close(network(blind).position, network(tower_batch).position)


def test_static_gating_decides_once(tower_batch: Batch) -> None:
    assert build("static_gating")(tower_batch).stable_logit.shape[1] == 1
    assert build("full")(tower_batch).stable_logit.shape[1] == 29


def test_an_object_sure_to_be_stable_stays(tower_batch: Batch) -> None:
    network = build("full")
    nn.init.zeros_(network.decoder.stable_logit.weight)
    nn.init.constant_(network.decoder.stable_logit.bias, 50.0)
    position = present(network(tower_batch), tower_batch)
    torch.testing.assert_close(position, present(CopyC()(tower_batch), tower_batch))


def test_npe_hears_only_those_within_its_radius(tower_batch: Batch) -> None:
    """Blocks moved 100 m apart: for IN the others matter, for NPE they might as well not be there."""
    apart = 100.0 * torch.arange(4.0)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    far = tower_batch._replace(initial=tower_batch.initial + apart)
    shifted = far._replace(initial=far.initial + 5 * torch.eye(4)[0][:, None])  # one colour moves, by 5 m
    for name, hears in (("npe", False), ("in", True)):
        network = build(name)
        moved = (network(shifted).position - network(far).position)[:, :, 1:]
        assert bool(moved.abs().max() > 1e-3) == hears


def test_copies_copy(tower_batch: Batch) -> None:
    torch.testing.assert_close(CopyC()(tower_batch).position[:, 17], tower_batch.initial)
    torch.testing.assert_close(CopyB()(tower_batch).position, tower_batch.observed[:, 1:])
    assert (CopyC()(tower_batch).stable_logit > 0).all()
    assert ((CopyB()(tower_batch).stable_logit > 0) == tower_batch.observed_stable).all()


def test_cophynet_overfits_one_batch(tower_batch: Batch) -> None:
    network, batch = build("full"), map_fields(itemgetter(slice(8)), tower_batch)
    optimizer = torch.optim.Adam(network.parameters(), lr=0.001)
    for _ in range(400):
        loss = position_loss(network(batch), batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.1 * position_loss(CopyC()(batch), batch)
