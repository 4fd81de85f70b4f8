"""Which items make up each batch, on each of the devices that share a run.

The order in training follows from seed and epoch alone, so that a resumed training sees what an undisturbed one would have
seen. A batch is shared among the devices: its size is that of a whole optimiser step.
"""

from typing import NamedTuple

import lightning as L
import numpy as np
from torch.utils.data import BatchSampler, Dataset, DistributedSampler

from cophy.errors import CophyError


class Share(NamedTuple):
    """The part of every batch that one device gets: every `devices`-th item, from `rank` on."""

    devices: int = 1
    rank: int = 0

    @classmethod
    def of(cls, trainer: L.Trainer | None) -> "Share":
        """That of the device that this process runs on."""
        return cls() if trainer is None else cls(trainer.world_size, trainer.global_rank)


ALONE = Share()


class EpochBatches(BatchSampler):
    """Batches in an order of their own in every epoch, which Lightning counts."""

    def set_epoch(self, epoch: int) -> None:
        """Call before an epoch."""
        assert isinstance(self.sampler, DistributedSampler)
        self.sampler.set_epoch(epoch)


def shuffled(dataset: Dataset, batch_size: int, *, seed: int, share: Share) -> EpochBatches:
    """Each item once an epoch; where devices share a run, a few twice, so that all get as many.

    Args:
        dataset: Of the items.
        batch_size: Items in a batch of all devices together.
        seed: The order follows from it and the epoch. PyTorch adds the two, so that seed 1 begins with the order that seed 0
            has in its second epoch; their weights begin differently.
        share: Of this device.
    """
    if batch_size % share.devices:
        raise CophyError(
            f"training.batch_size={batch_size} cannot be shared by {share.devices} devices: use a multiple"
        )
    order: DistributedSampler[int] = DistributedSampler(
        dataset, num_replicas=share.devices, rank=share.rank, shuffle=True, seed=seed
    )
    return EpochBatches(order, batch_size // share.devices, drop_last=False)


def in_order(groups: np.ndarray, batch_size: int, share: Share) -> list[list[int]]:
    """This device's share of all items, none twice: whole groups that follow each other, in as many batches on each device.

    Args:
        groups: (item,) equal for items that stay in one batch, such as twins; these follow each other.
        batch_size: About as many items are in a batch.
        share: Of this device.

    Raises:
        CophyError: There are fewer groups than devices.
    """
    first = np.flatnonzero(np.diff(groups, prepend=groups[0] - 1))
    if len(first) < share.devices:
        raise CophyError(f"{len(first)} groups of experiments cannot be shared by {share.devices} devices")
    items = np.split(np.arange(len(groups)), first[1:])
    shares = [items[part[0] : part[-1] + 1] for part in np.array_split(np.arange(len(items)), share.devices)]
    most = max(sum(map(len, each)) for each in shares)
    num_batches = min(-(-most // batch_size), *map(len, shares))
    batches = np.array_split(np.arange(len(shares[share.rank])), num_batches)
    return [[int(item) for group in batch for item in shares[share.rank][group]] for batch in batches]
