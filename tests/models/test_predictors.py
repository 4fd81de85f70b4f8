"""Properties that all predictors share."""

from dataclasses import replace

import pytest
import torch

from cophy.models.gns import MessagePassing
from cophy.models.layers import radius_graph
from cophy.training.losses import position_loss, stability_loss
from cophy.types import CONFOUNDERS, Batch, map_tensors, take
from tests.models.networks import (
    ALONGSIDES,
    NUM_FRAMES,
    OTHERS,
    SEES_APPEARANCE,
    TRAINED,
    build,
    permute_slots,
    present_positions,
    random_batch,
    with_noise_where_absent,
)

READ_AB = (
    "cophynet",
    "static_gating",
    "mlp",
    "single_step",
    "alongside",
    "alongside_no_replay",
    "gns",
    "transformer",
    "hypotheses",
)
DECLARE_APPEARANCE = ("cophynet", "in", "alongside", "gns", "transformer")
OF_EVERY_CLASS = (  # with the options that run most of its code, and those that run other code
    *("cophynet", "cophynet_true", "static_gating", "feedforward", "mlp", "single_step", "in", "npe_true"),
    *("alongside_walls", "alongside_no_replay", "gns_walls", "transformer", "hypotheses"),
)


@pytest.fixture(scope="module")
def batch() -> Batch:
    return random_batch(4, [4, 3, 2, 3])


@pytest.mark.parametrize("name", [*(name for name in TRAINED if name != "mlp"), "copy_b_displaced"])
def test_permuting_objects_permutes_the_prediction(name: str, batch: Batch) -> None:
    network, inputs, order = build(name, **SEES_APPEARANCE), batch.inputs, [2, 0, 3, 1]
    expected = present_positions(network(inputs), inputs)[:, :, order]
    permuted = permute_slots(inputs, order)
    torch.testing.assert_close(present_positions(network(permuted), permuted), expected, atol=1e-5, rtol=1e-4)


def test_an_mlp_over_slots_is_not_equivariant(batch: Batch) -> None:
    network, inputs, order = build("mlp"), batch.inputs, [2, 0, 3, 1]
    permuted = permute_slots(inputs, order)
    difference = (
        present_positions(network(permuted), permuted) - present_positions(network(inputs), inputs)[:, :, order]
    )
    assert difference.abs().max() > 0.01


@pytest.mark.parametrize("name", [*TRAINED, "copy_b", "copy_b_displaced", "copy_c"])
def test_absent_objects_change_nothing(name: str, batch: Batch) -> None:
    network, inputs = build(name, **SEES_APPEARANCE), batch.inputs
    noisy, expected = with_noise_where_absent(inputs), present_positions(network(inputs), inputs)
    torch.testing.assert_close(present_positions(network(noisy), inputs), expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("name", [*ALONGSIDES, *OTHERS])
def test_an_experiment_does_not_depend_on_its_batch(name: str, batch: Batch) -> None:
    """Neither does it for the others, which test_plain_loop.py compares with loops over experiments."""
    network, inputs = build(name), batch.inputs
    alone = take(inputs, slice(2, 3))
    expected = present_positions(network(inputs), inputs)[2:3]
    torch.testing.assert_close(present_positions(network(alone), alone), expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("name", TRAINED)
def test_every_parameter_gets_a_gradient(name: str, batch: Batch) -> None:
    network = build(name, **SEES_APPEARANCE)
    prediction = network(batch.inputs)
    loss = position_loss(prediction, batch.targets)
    if prediction.stable_logit is not None:
        loss = loss + stability_loss(prediction.stable_logit, batch.targets)
    loss.backward()
    assert [key for key, p in network.named_parameters() if p.grad is None or not p.grad.any()] == []


@pytest.mark.parametrize("name", ["gns", "gns_walls"])
def test_objects_of_an_untrained_gns_nearly_stay(name: str, batch: Batch) -> None:
    moved = present_positions(build(name)(batch.inputs), batch.inputs) - batch.inputs.initial[:, None]
    assert moved.norm(dim=-1).max() < 0.05 * NUM_FRAMES**2 / 2


def test_a_node_of_gns_sums_messages_without_their_residuals() -> None:
    """As published: residual nodes and edges are added after a step of message passing."""
    torch.manual_seed(0)
    step, nodes, edges = MessagePassing(4), torch.randn(1, 3, 4), torch.randn(1, 2, 3, 4)
    presence = torch.ones(1, 3, dtype=torch.bool)
    new_nodes, new_edges = step(nodes, edges, radius_graph(torch.zeros(1, 3, 3), presence, None))
    torch.testing.assert_close(new_nodes, nodes + step.node(torch.cat([nodes, (new_edges - edges).sum(dim=1)], dim=-1)))


@pytest.mark.parametrize("name", OF_EVERY_CLASS)
def test_double_precision_stays(name: str, batch: Batch) -> None:
    inputs = map_tensors(lambda t: t.double() if t.is_floating_point() else t, batch.inputs)
    assert build(name).double()(inputs).position.dtype == torch.float64


@pytest.mark.parametrize("name", ["feedforward", "in", "npe", "cophynet_true", "cophynet_without_pose", "in_true"])
def test_models_without_ab_ignore_it(name: str, batch: Batch) -> None:
    network, inputs = build(name, **SEES_APPEARANCE), batch.inputs
    blind = replace(inputs, observed=torch.zeros_like(inputs.observed))
    torch.testing.assert_close(network(blind).position, network(inputs).position)


@pytest.mark.parametrize("name", READ_AB)
def test_counterfactual_models_read_ab(name: str, batch: Batch) -> None:
    network, inputs = build(name), batch.inputs
    blind = replace(inputs, observed=torch.zeros_like(inputs.observed))
    assert (network(blind).position - network(inputs).position).abs().max() > 1e-6


@pytest.mark.parametrize("name", OF_EVERY_CLASS)
def test_only_models_with_true_confounders_need_them(name: str, batch: Batch) -> None:
    network, without = build(name), replace(batch.inputs, confounders=None)
    if name.endswith("_true"):
        with pytest.raises(ValueError, match="true confounders are not among the inputs"):
            network(without)
    else:
        torch.testing.assert_close(network(without).position, network(batch.inputs).position)


@pytest.mark.parametrize("model", ["cophynet", "in"])
def test_confounders_without_pose_are_those_before_the_shape(model: str, batch: Batch) -> None:
    """A change of any column changes the prediction of a model that sees it."""
    inputs, present = batch.inputs, batch.inputs.observed_presence
    for column, confounder in enumerate(CONFOUNDERS):
        changed = inputs.confounders.clone()
        changed[..., column] += present
        seen = {
            name: not torch.equal(
                build(f"{model}_{name}")(replace(inputs, confounders=changed)).position,
                build(f"{model}_{name}")(inputs).position,
            )
            for name in ("true", "without_pose")
        }
        is_pose = confounder in ("cylinder", "axis_x", "axis_y", "axis_z")
        assert seen == {"true": True, "without_pose": not is_pose}


@pytest.mark.parametrize("name", DECLARE_APPEARANCE)
@pytest.mark.parametrize("field", ["object_type", "pose"])
def test_appearance_is_read_only_where_it_is_enabled(name: str, field: str, batch: Batch) -> None:
    inputs = batch.inputs
    changed = replace(inputs, **{field: -getattr(inputs, field)})
    sees, blind = build(name, **{field: True}), build(name)
    difference = present_positions(sees(changed), inputs) - present_positions(sees(inputs), inputs)
    assert difference.abs().max() > 1e-5
    without = replace(inputs, object_type=None, pose=None)
    torch.testing.assert_close(blind(changed).position, blind(without).position, atol=0, rtol=0)
    with pytest.raises(ValueError, match=f"{field} is not among the inputs: a model needs {field}: true for it"):
        sees(without)


@pytest.mark.parametrize("name", [name for name in OF_EVERY_CLASS if name != "mlp"])
def test_a_batch_without_objects_is_predicted(name: str, batch: Batch) -> None:
    nothing = torch.zeros_like(batch.inputs.presence)
    empty = replace(batch.inputs, presence=nothing, observed_presence=nothing)
    assert build(name)(empty).position.shape == (4, NUM_FRAMES - 1, 4, 3)
