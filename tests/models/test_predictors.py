"""Predictors by property."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from cophy.models.baselines import CopyB, CopyC
from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch, Inputs, map_tensors, take
from tests.models.networks import ABLATIONS, ALONGSIDE, OTHERS, build, permuted, present


@pytest.fixture(params=[*(name for name in ABLATIONS if name != "mlp"), *OTHERS])
def network(request: pytest.FixtureRequest) -> nn.Module:
    return build(request.param)


@pytest.fixture(params=[*ABLATIONS, *OTHERS])
def any_network(request: pytest.FixtureRequest) -> nn.Module:
    return build(request.param)


@pytest.fixture
def inputs(tower_batch: Batch) -> Inputs:
    """What is seen of all tiny towers."""
    return tower_batch.inputs


def test_permuting_objects_permutes_the_prediction(network: nn.Module, inputs: Inputs) -> None:
    order = [2, 0, 3, 1]
    expected = present(network(inputs), inputs).index_select(2, torch.tensor(order))
    changed = permuted(inputs, order)
    torch.testing.assert_close(present(network(changed), changed), expected, atol=1e-5, rtol=1e-4)


def test_an_mlp_over_slots_is_the_one_that_is_not_equivariant(inputs: Inputs) -> None:
    network, order = build("mlp"), [2, 0, 3, 1]
    expected = present(network(inputs), inputs).index_select(2, torch.tensor(order))
    changed = permuted(inputs, order)
    assert (present(network(changed), changed) - expected).abs().max() > 0.01


def test_absent_objects_change_nothing(any_network: nn.Module, inputs: Inputs) -> None:
    absent_ab, absent_cd = ~inputs.observed_presence, ~inputs.presence
    noise = map_tensors(lambda t: torch.randn(t.shape) if t.is_floating_point() else t, inputs)
    noisy = replace(
        inputs,
        observed=torch.where(absent_ab[:, None, :, None], noise.observed, inputs.observed),
        initial=torch.where(absent_cd[..., None], noise.initial, inputs.initial),
        confounders=torch.where(absent_ab[..., None], noise.confounders, inputs.confounders),
    )
    expected = present(any_network(inputs), inputs)
    torch.testing.assert_close(present(any_network(noisy), inputs), expected, atol=1e-5, rtol=1e-4)


def test_an_experiment_does_not_depend_on_its_batch(any_network: nn.Module, inputs: Inputs) -> None:
    alone = take(inputs, slice(5, 6))
    torch.testing.assert_close(
        present(any_network(alone), alone), present(any_network(inputs), inputs)[5:6], atol=1e-5, rtol=1e-4
    )


@pytest.mark.parametrize("choice", [*ABLATIONS, "in", "npe", "in gt_confounders", *ALONGSIDE])
def test_every_parameter_gets_a_gradient(choice: str, tower_batch: Batch) -> None:
    network = build(choice)
    prediction = network(tower_batch.inputs)
    loss = position_loss(prediction, tower_batch.targets)
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, tower_batch.targets)
    loss.backward()
    without = [
        name for name, parameter in network.named_parameters() if parameter.grad is None or not parameter.grad.any()
    ]
    assert not without


@pytest.mark.parametrize("choice", ["feedforward", "in", "npe"])
def test_what_never_sees_ab_cannot_tell_twins_apart(choice: str, inputs: Inputs) -> None:
    position = build(choice)(inputs).position
    torch.testing.assert_close(position[::2], position[1::2])


@pytest.mark.parametrize("ablation", ["full", "static_gating", "mlp", "single_step", *ALONGSIDE])
def test_counterfactual_models_read_ab(ablation: str, inputs: Inputs) -> None:
    position = build(ablation)(inputs).position
    assert (position[::2] - position[1::2]).abs().max() > 1e-6


@pytest.mark.parametrize("choice", ["gt_confounders", "in gt_confounders"])
def test_true_confounders_replace_ab(choice: str, inputs: Inputs) -> None:
    network = build(choice)
    blind = replace(inputs, observed=torch.zeros_like(inputs.observed))
    torch.testing.assert_close(network(blind).position, network(inputs).position)


@pytest.mark.parametrize("choice", [*ABLATIONS, *OTHERS])
def test_only_what_is_configured_to_see_true_confounders_needs_them(choice: str, inputs: Inputs) -> None:
    network, without = build(choice), replace(inputs, confounders=None)
    if "gt_confounders" in choice:
        with pytest.raises(ValueError, match="true confounders are not among the inputs"):
            network(without)
    else:
        torch.testing.assert_close(network(without).position, network(inputs).position)


@pytest.mark.parametrize("choice", [*(name for name in ABLATIONS if name != "mlp"), *OTHERS])
def test_a_batch_without_any_object_is_answered(choice: str, inputs: Inputs) -> None:
    nothing = torch.zeros_like(inputs.presence)
    empty = replace(inputs, presence=nothing, observed_presence=nothing)
    assert build(choice)(empty).position.shape == (len(inputs), 29, 4, 3)


def test_static_gating_decides_once(inputs: Inputs) -> None:
    assert build("static_gating")(inputs).stable_logit.shape[1] == 1
    assert build("full")(inputs).stable_logit.shape[1] == 29


def test_an_object_sure_to_be_stable_stays(inputs: Inputs) -> None:
    network = build("full")
    nn.init.zeros_(network.decoder.to_stable_logit.weight)
    nn.init.constant_(network.decoder.to_stable_logit.bias, 50.0)
    position = present(network(inputs), inputs)
    torch.testing.assert_close(position, present(CopyC()(inputs), inputs))


def test_npe_hears_only_those_within_its_radius(inputs: Inputs) -> None:
    """Blocks moved 100 m apart: for IN the others matter, for NPE they might as well not be there."""
    apart = 100.0 * torch.arange(4.0)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    far = replace(inputs, initial=inputs.initial + apart)
    shifted = replace(far, initial=far.initial + 5 * torch.eye(4)[0][:, None])  # one colour moves, by 5 m
    for name, hears in (("npe", False), ("in", True)):
        network = build(name)
        moved = (network(shifted).position - network(far).position)[:, :, 1:]
        assert bool(moved.abs().max() > 1e-3) == hears


def test_copies_copy(inputs: Inputs) -> None:
    torch.testing.assert_close(CopyC()(inputs).position[:, 17], inputs.initial)
    torch.testing.assert_close(CopyB()(inputs).position, inputs.observed[:, 1:])
    assert (CopyC()(inputs).stable_logit > 0).all()
    assert ((CopyB()(inputs).stable_logit > 0) == inputs.observed_stable).all()


def test_copy_b_leaves_what_was_missed_in_ab_where_it_is_in_c(inputs: Inputs) -> None:
    missed = inputs.observed_presence.clone()
    missed[:, 0] = False
    none_stable = torch.zeros_like(inputs.observed_stable)
    prediction = CopyB()(replace(inputs, observed_presence=missed, observed_stable=none_stable))
    assert ((prediction.stable_logit[:, :, 0] > 0) == inputs.presence[:, None, 0]).all()
    assert not (prediction.stable_logit[:, :, 1:][:, :, missed[0, 1:]] > 0).any()
    position = prediction.position
    torch.testing.assert_close(position[:, :, 0], inputs.initial[:, None, 0].expand(-1, 29, -1))
    torch.testing.assert_close(position[:, :, 1:][:, :, missed[0, 1:]], inputs.observed[:, 1:, 1:][:, :, missed[0, 1:]])


def test_cophynet_overfits_one_batch(tower_batch: Batch) -> None:
    network, batch = build("full"), take(tower_batch, slice(8))
    optimizer = torch.optim.Adam(network.parameters(), lr=0.004)
    for _ in range(120):
        loss = position_loss(network(batch.inputs), batch.targets)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(
            network.parameters(), 1.0
        )  # as in training (conf/trainer): rollouts explode now and then
        optimizer.step()
    assert loss < 0.1 * position_loss(CopyC()(batch.inputs), batch.targets)
