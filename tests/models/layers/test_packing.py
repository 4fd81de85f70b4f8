"""Packing leaves out slots, and unpacking puts every object back."""

import torch

from cophy.models.layers import pack, unpack
from cophy.types import Batch, Prediction, take
from tests.models.networks import random_batch


def test_unpacking_puts_every_object_back(tower_batch: Batch) -> None:
    inputs, targets = tower_batch.inputs, tower_batch.targets
    packed, slots = pack(inputs)
    assert packed.initial.shape[1] == 3  # towers of three in four slots
    prediction = unpack(
        Prediction(packed.observed[:, 1:], packed.observed_stable.float(), packed.confounders), slots, 4
    )
    torch.testing.assert_close(prediction.position, inputs.observed[:, 1:])
    present = targets.observed_presence
    torch.testing.assert_close(prediction.stable_logit, inputs.observed_stable.float() * present[:, None])
    torch.testing.assert_close(prediction.confounder_estimate, inputs.confounders * present[..., None])


def test_packed_objects_keep_their_order_and_their_features() -> None:
    inputs = random_batch(9, [2, 4]).inputs
    packed, slots = pack(inputs)
    assert packed.presence.shape == (2, 4)
    for n in range(2):
        used = (inputs.observed_presence | inputs.presence)[n].nonzero().flatten()
        assert slots[n, : len(used)].tolist() == used.tolist()
        torch.testing.assert_close(packed.initial[n, : len(used)], inputs.initial[n, used])
        torch.testing.assert_close(packed.observed[n, :, : len(used)], inputs.observed[n][:, used])


def test_an_experiment_without_objects_is_packed_too() -> None:
    inputs = take(random_batch(4, [3]).inputs, slice(0, 1))
    inputs.presence, inputs.observed_presence = (torch.zeros(1, 4, dtype=torch.bool) for _ in range(2))
    packed, _ = pack(inputs)
    assert packed.initial.shape == (1, 2, 3)
