"""One split of experiments, whole in memory, batched by slicing."""

from torch.utils.data import BatchSampler, DataLoader, Dataset, RandomSampler, SequentialSampler

from cophy.types import Batch, take


class CounterfactualDataset(Dataset[Batch]):
    """An index is a list of experiments, an item their `Batch`."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, indices: list[int]) -> Batch:
        return take(self.batch, indices)

    def loader(self, batch_size: int, *, shuffle: bool) -> DataLoader[Batch]:
        """Batches of up to `batch_size` experiments, sliced at once: no worker processes are worth their cost."""
        sampler = RandomSampler(self) if shuffle else SequentialSampler(self)
        return DataLoader(self, sampler=BatchSampler(sampler, batch_size, drop_last=False), batch_size=None)
