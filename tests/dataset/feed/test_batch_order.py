"""Every item once, the same order for the same epoch, and the same batches however many devices share them."""

from itertools import chain

import numpy as np
import pytest
import torch
from torch.utils.data import TensorDataset

from cophy.dataset.datamodules import ALONE, EpochBatches, Share, in_order, shuffled
from cophy.errors import CophyError

ITEMS = TensorDataset(torch.arange(22))


def epoch_of(batches: EpochBatches, epoch: int) -> list[list[int]]:
    batches.set_epoch(epoch)
    return list(batches)


def test_an_epoch_has_an_order_of_its_own_that_comes_again() -> None:
    first, again = (epoch_of(shuffled(ITEMS, 8, seed=1, share=ALONE), 3) for _ in range(2))
    assert first == again
    assert sorted(chain(*first)) == list(range(22))
    assert [len(batch) for batch in first] == [8, 8, 6]
    assert epoch_of(shuffled(ITEMS, 8, seed=1, share=ALONE), 4) != first
    assert epoch_of(shuffled(ITEMS, 8, seed=2, share=ALONE), 3) != first


def test_devices_share_the_batches_of_one() -> None:
    whole = epoch_of(shuffled(ITEMS, 8, seed=1, share=ALONE), 2)
    shares = [epoch_of(shuffled(ITEMS, 8, seed=1, share=Share(2, rank)), 2) for rank in range(2)]
    assert [[batch[rank::2] for batch in whole] for rank in range(2)] == shares
    with pytest.raises(CophyError, match="cannot be shared by 3 devices"):
        shuffled(ITEMS, 8, seed=1, share=Share(3, 0))


@pytest.mark.parametrize("devices", [1, 2, 3, 4])
@pytest.mark.parametrize("groups", [np.repeat(np.arange(11), 2), np.arange(22), np.repeat([3, 4, 5, 6], [2, 1, 2, 17])])
def test_in_order_every_item_is_met_once_and_twins_together(groups: np.ndarray, devices: int) -> None:
    shares = [in_order(groups, 4, Share(devices, rank)) for rank in range(devices)]
    batches = list(chain(*shares))
    assert list(chain(*batches)) == list(range(22))
    assert all(batches)
    assert len({len(share) for share in shares}) == 1  # devices wait for each other at every batch
    met = [set(groups[batch].tolist()) for batch in batches]
    assert not [one & other for n, one in enumerate(met) for other in met[n + 1 :] if one & other]


def test_fewer_groups_than_devices_are_refused() -> None:
    with pytest.raises(CophyError, match="cannot be shared by 3 devices"):
        in_order(np.repeat([0, 1], 2), 4, Share(3, 0))
