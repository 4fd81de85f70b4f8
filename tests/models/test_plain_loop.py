"""Outputs and gradients of the networks against plain loops over objects (plain_loop.py)."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch, Inputs, Prediction
from tests.models import plain_loop
from tests.models.networks import COPHYNETS, INTERACTION_NETWORKS, SEES_APPEARANCE, build, random_batch


def outcome(
    network: nn.Module, predict: Callable[[Inputs], Prediction], batch: Batch
) -> tuple[list[Tensor], dict[str, Tensor]]:
    """Return predictions for present objects and the gradients of the training loss."""
    network.zero_grad()
    prediction, presence = predict(batch.inputs), batch.targets.presence[:, None]
    loss = position_loss(prediction, batch.targets)
    outputs = [prediction.position[presence.expand(prediction.position.shape[:3])]]
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, batch.targets)
        outputs.append(prediction.stable_logit[presence.expand(prediction.stable_logit.shape)])
    if prediction.confounder_estimate is not None:
        outputs.append(prediction.confounder_estimate[batch.targets.observed_presence])
    loss.backward()
    return outputs, {name: parameter.grad.clone() for name, parameter in network.named_parameters()}


@pytest.mark.parametrize(
    ("num_objects", "appearance"),
    [([4, 3, 1, 2, 2, 4], {}), ([1, 3], SEES_APPEARANCE)],
    ids=["positions", "appearance"],
)
@pytest.mark.parametrize("name", [*COPHYNETS, *INTERACTION_NETWORKS])
def test_a_network_equals_its_plain_loop(name: str, num_objects: list[int], appearance: dict) -> None:
    network, batch = build(name, **appearance), random_batch(4, num_objects)
    batched, gradients = outcome(network, network, batch)
    plain, plain_gradients = outcome(network, lambda inputs: plain_loop.predict(network, inputs), batch)
    for value, expected in zip(batched, plain, strict=True):
        torch.testing.assert_close(value, expected, atol=1e-5, rtol=0)
    for key, gradient in gradients.items():
        torch.testing.assert_close(
            gradient, plain_gradients[key], atol=1e-5, rtol=1e-5, msg=lambda text, key=key: f"{key}: {text}"
        )
