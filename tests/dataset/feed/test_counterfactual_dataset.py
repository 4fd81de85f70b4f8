"""One split in memory."""

import torch

from cophy.dataset.datamodules import CounterfactualDataset
from cophy.dataset.features import to_batch


def test_a_loader_visits_every_experiment_once(tiny) -> None:
    spec, arrays = tiny
    data = CounterfactualDataset(to_batch(arrays, spec.scenario))
    batches = list(data.shuffled(16))
    assert [len(batch) for batch in batches] == [16, 16, 16]
    sums = torch.cat([batch.targets.position for batch in batches]).flatten(1).sum(dim=1)
    torch.testing.assert_close(sums.sort().values, data.batch.targets.position.flatten(1).sum(dim=1).sort().values)
