"""The fast form of CoPhyNet against the plain loop over objects and frames (benchmarks/reference.py)."""

from collections.abc import Callable

import pytest
import torch
from omegaconf import OmegaConf
from torch import Tensor

from benchmarks import reference
from cophy.models.cophynet import CoPhyNet
from cophy.training.losses import position_loss, stability_loss
from cophy.training.run import build_network
from cophy.types import CONFOUNDERS, Batch, Prediction
from tests.conftest import composed


def build(hidden_dim: int) -> CoPhyNet:
    """CoPhyNet as conf/ has it; `hidden_dim` other than its input's widths, so that no two can be mixed up."""
    config = composed("train", f"model.hidden_dim={hidden_dim}")
    torch.manual_seed(0)
    network = build_network(OmegaConf.to_container(config.model, resolve=True, enum_to_str=True))
    assert isinstance(network, CoPhyNet)
    return network


def balls(num_slots: int, num_objects: list[int]) -> Batch:
    """Random experiments of so many objects each; from every second one, the do-operation removes one."""
    size, generator = len(num_objects), torch.Generator().manual_seed(0)
    order = torch.rand(size, num_slots, generator=generator).argsort(dim=1)
    observed_presence = order < torch.tensor(num_objects)[:, None]
    presence = observed_presence & ((order > 0) | (torch.arange(size) % 2 == 0)[:, None])

    def random(*shape: int) -> Tensor:
        return torch.randn(size, *shape, generator=generator)

    return Batch(
        observed=random(30, num_slots, 3) * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=random(29, num_slots) > 0,
        initial=random(num_slots, 3) * presence[..., None],
        presence=presence,
        confounders=random(num_slots, len(CONFOUNDERS)),
        confounder_class=torch.zeros(size, num_slots, 2, dtype=torch.long),
        target=random(29, num_slots, 3),
        target_initial=random(num_slots, 3),
        target_presence=presence,
        stable=random(29, num_slots) > 0,
    )


def outcome(
    network: CoPhyNet, predict: Callable[[Batch], Prediction], batch: Batch
) -> tuple[list[Tensor], dict[str, Tensor]]:
    """What is predicted of present objects, and the gradient of the training loss."""
    network.zero_grad()
    prediction = predict(batch)
    assert prediction.stable_logit is not None
    assert prediction.confounder_estimate is not None
    (position_loss(prediction, batch) + stability_loss(prediction.stable_logit, batch)).backward()
    seen = [
        prediction.position[batch.presence[:, None].expand(prediction.stable_logit.shape)],
        prediction.stable_logit[batch.presence[:, None].expand(prediction.stable_logit.shape)],
        prediction.confounder_estimate[batch.observed_presence],
    ]
    return seen, {name: parameter.grad.clone() for name, parameter in network.named_parameters()}


@pytest.mark.parametrize(
    ("num_slots", "num_objects"), [(4, [3, 3, 3, 3]), (9, [4, 4, 6, 2, 1, 2]), (4, [2, 2])], ids=str
)
def test_the_fast_form_equals_the_plain_loop(num_slots: int, num_objects: list[int]) -> None:
    network, batch = build(24), balls(num_slots, num_objects)
    fast, fast_gradients = outcome(network, network, batch)
    plain, plain_gradients = outcome(network, lambda batch: reference.predict(network, batch), batch)
    for one, other in zip(fast, plain, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=0)
    for name, gradient in fast_gradients.items():
        torch.testing.assert_close(
            gradient, plain_gradients[name], atol=1e-5, rtol=0, msg=lambda m, n=name: f"{n}: {m}"
        )
