"""The batched networks against plain loops over objects (plain_loop.py): outputs and gradients."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch, Inputs, Prediction
from tests.models import plain_loop
from tests.models.networks import ABLATIONS, INTERACTION_NETWORKS, SEES_LOOKS, build, random_batch

NUM_FRAMES = 7


def outcome(
    network: nn.Module, predict: Callable[[Inputs], Prediction], batch: Batch
) -> tuple[list[Tensor], dict[str, Tensor]]:
    """What is predicted of present objects, and the gradient of the training loss."""
    network.zero_grad()
    prediction, presence = predict(batch.inputs), batch.targets.presence[:, None]
    loss = position_loss(prediction, batch.targets)
    seen = [prediction.position[presence.expand(prediction.position.shape[:3])]]
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, batch.targets)
        seen.append(prediction.stable_logit[presence.expand(prediction.stable_logit.shape)])
    if prediction.confounder_estimate is not None:
        seen.append(prediction.confounder_estimate[batch.targets.observed_presence])
    loss.backward()
    return seen, {name: parameter.grad.clone() for name, parameter in network.named_parameters()}


@pytest.mark.parametrize(
    ("num_objects", "looks"),
    [([3, 3, 3, 3], ()), ([4, 3, 1, 2, 2, 4], ()), ([4, 3, 1, 2], SEES_LOOKS), ([4, 3, 1, 2], SEES_LOOKS[1:])],
    ids=str,
)
@pytest.mark.parametrize("choice", [*ABLATIONS, *INTERACTION_NETWORKS])
def test_a_network_is_its_plain_loop(choice: str, num_objects: list[int], looks: tuple[str, ...]) -> None:
    narrow = ["model.hidden_dim=24", *looks]  # unlike the width of any input, so that no two can be mixed up
    if choice == "single_step":
        narrow.append(f"scenario.clock.num_frames={NUM_FRAMES}")
    if choice.startswith("npe"):
        narrow.append("model.radius=2.0")  # some random objects are nearer, some are not
    network, batch = build(choice, *narrow), random_batch(4, num_objects, NUM_FRAMES)
    batched, gradients = outcome(network, network, batch)
    plain, plain_gradients = outcome(network, lambda inputs: plain_loop.predict(network, inputs), batch)
    for one, other in zip(batched, plain, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=0)
    for name, gradient in gradients.items():
        torch.testing.assert_close(
            gradient, plain_gradients[name], atol=1e-5, rtol=1e-5, msg=lambda m, n=name: f"{n}: {m}"
        )
