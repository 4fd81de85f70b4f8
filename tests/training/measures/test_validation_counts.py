"""The MSE of each cell, and towers that stand or fall, over batches."""

import torch

from cophy.training.metrics import MeanOfEachCell, StandingConfusion
from cophy.types import Prediction, take
from tests.models.networks import random_batch


def test_every_cell_has_its_own_mean() -> None:
    mean = MeanOfEachCell(3)
    mean.update(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([0, 2, -1]))
    mean.update(torch.tensor([3.0]), torch.tensor([0]))
    torch.testing.assert_close(mean.compute(), torch.tensor([2.0, torch.nan, 2.0]).double(), equal_nan=True)


def test_experiments_of_a_cell_are_counted_in_every_precision() -> None:
    mean = MeanOfEachCell(1).to(torch.bfloat16)
    for _ in range(3):
        mean.update(torch.ones(200, dtype=torch.bfloat16), torch.zeros(200, dtype=torch.int64))
    assert mean.count.tolist() == [600]


def test_a_tower_stands_if_all_its_objects_do() -> None:
    targets = random_batch(4, [2, 2, 2, 2], num_frames=3).targets
    stands = torch.tensor([True, True, False, False])
    targets.stable[:] = stands[:, None, None]
    logit = torch.where(targets.presence[:, None], 1.0, -1.0).repeat(1, 2, 1)  # what is not there does not count
    slot = targets.presence[1].int().argmax()
    logit[1, 0, slot] = logit[2, 0, targets.presence[2].int().argmax()] = -1.0
    confusion = StandingConfusion()
    for rows in ([0, 1], [2, 3]):
        confusion.update(take(Prediction(targets.position, logit), rows), take(targets, rows))
    assert confusion.compute().tolist() == [[1, 1], [1, 1]]
