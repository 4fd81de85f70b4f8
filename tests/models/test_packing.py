import torch

from cophy.models.packing import pack, unpack
from cophy.types import Batch, Prediction


def test_unpacking_puts_every_object_back(tower_batch: Batch) -> None:
    packed, slots = pack(tower_batch)
    assert packed.initial.shape[1] == 3  # towers of three in four slots
    prediction = unpack(Prediction(packed.target, packed.stable.float(), packed.confounders), slots, 4)
    present = tower_batch.observed_presence
    torch.testing.assert_close(prediction.position, tower_batch.target)
    torch.testing.assert_close(prediction.stable_logit, tower_batch.stable.float() * present[:, None])
    torch.testing.assert_close(prediction.confounder_estimate, tower_batch.confounders * present[..., None])
