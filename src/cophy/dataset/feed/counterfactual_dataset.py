"""One split of experiments, whole in memory, batched by slicing."""

from torch.utils.data import DataLoader, Dataset

from cophy.dataset.feed.batch_order import ALONE, Share, in_order, shuffled
from cophy.types import Batch, take


class CounterfactualDataset(Dataset[Batch]):
    """An index is a list of experiments, an item their `Batch`: sliced at once, no worker processes are worth their cost."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, indices: list[int]) -> Batch:
        return take(self.batch, indices)

    def shuffled(self, batch_size: int, *, seed: int = 0, share: Share = ALONE) -> DataLoader[Batch]:
        """Batches to train on.

        Args:
            batch_size: Experiments in a batch of all devices together.
            seed: Of the training.
            share: Of this device.
        """
        batches = shuffled(self, batch_size, seed=seed, share=share)
        return DataLoader(self, sampler=batches, batch_size=None)

    def in_order(self, batch_size: int, *, share: Share = ALONE) -> DataLoader[Batch]:
        """Every experiment once; twins, which follow each other, stay in one batch.

        Args:
            batch_size: About as many experiments are in a batch.
            share: Of this device.
        """
        batches = in_order(self.batch.targets.pair.numpy(), batch_size, share)
        return DataLoader(self, sampler=batches, batch_size=None)
