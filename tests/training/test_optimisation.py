"""Schedules of the learning rate, and optimisers that fail."""

from pathlib import Path

import pytest
from torch import nn
from torch.optim import SGD
from torch.optim.lr_scheduler import LambdaLR

from cophy.training.optimisation import constant, cosine_to_zero
from tests.commands import train


def rates(optimizer: SGD, schedule: LambdaLR, epochs: int) -> list[float]:
    """Return the learning rates of the next epochs."""
    values = []
    for _ in range(epochs):
        values.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    return values


def start(epochs: int) -> tuple[SGD, LambdaLR]:
    optimizer = SGD(nn.Linear(1, 1).parameters(), lr=0.5)
    return optimizer, cosine_to_zero(optimizer, epochs)


def test_a_longer_training_continues_at_its_own_rates() -> None:
    shorter, longer = start(4), start(8)
    expected = rates(*longer, 8)
    assert rates(*shorter, 4)[-1] < expected[3]
    optimizer, schedule = start(8)
    optimizer.load_state_dict(shorter[0].state_dict())  # in Lightning's order
    schedule.load_state_dict(shorter[1].state_dict())
    assert rates(optimizer, schedule, 4) == pytest.approx(expected[4:], abs=1e-12)


def test_a_training_without_a_last_epoch_has_no_cosine() -> None:
    with pytest.raises(ValueError, match=r"trainer\.max_epochs=-1 has no last epoch.*schedule=constant"):
        start(-1)
    optimizer = SGD(nn.Linear(1, 1).parameters(), lr=0.5)
    assert rates(optimizer, constant(optimizer, -1), 3) == [0.5] * 3


def test_gradients_too_large_for_soap_are_an_error_of_the_user(tiny_data: Path, tmp_path: Path) -> None:
    keys = ("scenario=collision", "model=in", "training.position_noise=1e300", f"hydra.run.dir={tmp_path}")
    printed = train(*keys, data=tiny_data, code=1)
    assert "training: gradients are too large for the optimizer, lower learning_rate" in printed.splitlines()[-1]
    assert "Traceback" not in printed
