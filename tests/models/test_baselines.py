"""Copy B, copy C, IN and NPE."""

from dataclasses import replace

import pytest
import torch

from cophy.errors import CophyError
from cophy.models import CopyB, CopyC
from cophy.types import Inputs
from tests.models.networks import build, random_batch


@pytest.fixture
def inputs() -> Inputs:
    """Four objects each; in the second experiment one of them is removed."""
    return random_batch(4, [4, 4]).inputs


def test_copy_c_repeats_c_and_copy_b_repeats_b(inputs: Inputs) -> None:
    torch.testing.assert_close(CopyC()(inputs).position[:, 3], inputs.initial)
    torch.testing.assert_close(CopyB()(inputs).position, inputs.observed[:, 1:])
    assert (CopyC()(inputs).stable_logit > 0).all()
    assert ((CopyB()(inputs).stable_logit > 0) == inputs.observed_stable).all()


def test_copy_b_leaves_an_object_missed_in_ab_where_it_is_in_c(inputs: Inputs) -> None:
    missed = inputs.observed_presence.clone()
    missed[:, 0] = False
    prediction = CopyB()(replace(inputs, observed_presence=missed))
    torch.testing.assert_close(
        prediction.position[:, :, 0], inputs.initial[:, None, 0].expand(-1, inputs.num_steps, -1)
    )
    torch.testing.assert_close(prediction.position[:, :, 1:], inputs.observed[:, 1:, 1:])
    assert ((prediction.stable_logit > 0)[:, :, 0] >= inputs.presence[:, None, 0]).all()
    assert ((prediction.stable_logit > 0)[:, :, 1:] == inputs.observed_stable[:, :, 1:]).all()


def test_npe_sees_only_objects_within_its_radius(inputs: Inputs) -> None:
    """With blocks 100 m apart, others matter for IN, and might as well be absent for NPE."""
    apart = 100.0 * torch.arange(4.0)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    far = replace(inputs, initial=inputs.initial + apart)
    shifted = replace(far, initial=far.initial + 5 * torch.eye(4)[0][:, None])  # the first slot moves by 5 m
    for name, sees_others in (("npe", False), ("in", True)):
        network = build(name)
        change = (network(shifted).position - network(far).position)[:, :, 1:]
        assert bool(change.abs().max() > 1e-3) == sees_others


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"edge_layers": 1}, "model.edge_layers=1 must be at least 2"),
        ({"node_layers": 0}, "model.node_layers=0 must be at least 1"),
        ({"hidden_dim": 0}, "model.hidden_dim=0 must be at least 1"),
        ({"radius": 0.0}, r"model.radius=0\.0 must be positive"),
        ({"confounders": "estimated"}, "model.confounders=estimated must be one of ground_truth"),
    ],
)
def test_arguments_out_of_range_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(CophyError, match=message):
        build("npe", **arguments)
