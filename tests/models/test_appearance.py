"""Predictors that see object types and poses, by property."""

from dataclasses import replace

import pytest
import torch

from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch
from tests.models.networks import ABLATIONS, INTERACTION_NETWORKS, SEES_LOOKS, build, permuted, present, random_batch

NUM_FRAMES = 7
CHOICES = (*ABLATIONS, *INTERACTION_NETWORKS)
every_choice = pytest.mark.parametrize("choice", CHOICES)


def network_of(choice: str, *overrides: str) -> torch.nn.Module:
    return build(choice, "model.hidden_dim=24", f"scenario.clock.num_frames={NUM_FRAMES}", *overrides)


@pytest.fixture
def batch() -> Batch:
    return random_batch(4, [4, 3, 2, 3], NUM_FRAMES)


@pytest.mark.parametrize("choice", [choice for choice in CHOICES if choice != "mlp"])
def test_permuting_objects_permutes_the_prediction(choice: str, batch: Batch) -> None:
    network, inputs, order = network_of(choice, *SEES_LOOKS), batch.inputs, [2, 0, 3, 1]
    expected = present(network(inputs), inputs)[:, :, order]
    changed = permuted(inputs, order)
    torch.testing.assert_close(present(network(changed), changed), expected, atol=1e-5, rtol=1e-4)


@every_choice
def test_looks_of_absent_objects_change_nothing(choice: str, batch: Batch) -> None:
    network, inputs = network_of(choice, *SEES_LOOKS), batch.inputs
    absent = ~inputs.observed_presence[..., None]
    noisy = replace(inputs, object_type=inputs.object_type + 9 * absent, pose=inputs.pose + 9 * absent)
    torch.testing.assert_close(present(network(noisy), inputs), present(network(inputs), inputs), atol=1e-5, rtol=1e-4)


@every_choice
@pytest.mark.parametrize("name", ["object_type", "pose"])
def test_what_is_declared_is_seen_and_what_is_not_is_not(choice: str, name: str, batch: Batch) -> None:
    inputs = batch.inputs
    other = replace(inputs, **{name: -getattr(inputs, name)})
    sees, blind = (network_of(choice, *keys) for keys in ([f"model.{name}=true"], []))
    assert (present(sees(other), inputs) - present(sees(inputs), inputs)).abs().max() > 1e-4
    without = replace(inputs, object_type=None, pose=None)
    torch.testing.assert_close(blind(other).position, blind(without).position, atol=0, rtol=0)
    with pytest.raises(ValueError, match=f"{name} is not among the inputs: a model needs {name}: true for it"):
        sees(without)


@every_choice
def test_every_parameter_gets_a_gradient(choice: str, batch: Batch) -> None:
    network = network_of(choice, *SEES_LOOKS)
    prediction = network(batch.inputs)
    loss = position_loss(prediction, batch.targets)
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, batch.targets)
    loss.backward()
    assert not [name for name, each in network.named_parameters() if each.grad is None or not each.grad.any()]


@pytest.mark.parametrize("choice", ["full", "static_gating", "mlp", "single_step"])
def test_the_estimator_sees_looks_of_ab_too(choice: str, batch: Batch) -> None:
    network, inputs = network_of(choice, *SEES_LOOKS), batch.inputs
    other = network(replace(inputs, pose=-inputs.pose)).confounder_estimate
    difference = (other - network(inputs).confounder_estimate) * inputs.observed_presence[..., None]
    assert difference.abs().max() > 1e-4


@pytest.mark.parametrize("choice", ["feedforward", "in", "npe"])
def test_what_never_sees_ab_does_not_read_it_by_its_looks(choice: str, batch: Batch) -> None:
    network, inputs = network_of(choice, *SEES_LOOKS), batch.inputs
    blind = replace(inputs, observed=torch.zeros_like(inputs.observed))
    torch.testing.assert_close(network(blind).position, network(inputs).position)
