"""Means, intervals and the probe."""

import numpy as np
import pytest
import torch

from cophy.training.evaluation import interval, mean
from cophy.training.probe import probe
from cophy.types import Batch


def test_experiments_that_do_not_count_are_left_out() -> None:
    assert mean(np.array([1.0, np.nan, 3.0])) == 2.0


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    covered = [low <= 1.0 <= high for low, high in (interval(rng.exponential(1.0, 100)) for _ in range(300))]
    assert 0.90 <= np.mean(covered) <= 0.97


def test_the_interval_shrinks_with_the_root_of_the_experiments() -> None:
    values = np.random.default_rng(0).normal(size=10000)
    width = [np.ptp(interval(values[:count])) for count in (100, 10000)]
    assert width[0] / width[1] == pytest.approx(10, rel=0.25)


def labelled(count: int, seed: int) -> tuple[torch.Tensor, Batch]:
    """U that gives the mass away and says nothing about friction; the second of two slots is empty every other time."""
    generator = torch.Generator().manual_seed(seed)
    classes = torch.randint(0, 2, (count, 2, 2), generator=generator)
    presence = torch.ones(count, 2, dtype=torch.bool)
    presence[::2, 1] = False
    noise = torch.randn(count, 2, 4, generator=generator)
    estimate = noise + 20 * classes[..., :1] * torch.tensor([1.0, 0, 0, 0])
    empty = torch.zeros(0)
    batch = Batch(empty, presence, empty, empty, presence, empty, classes, empty, empty)
    return torch.where(presence[..., None], estimate, 1e6), batch


def test_the_probe_finds_what_is_there_and_nothing_else() -> None:
    values = {name: value.mean() for name, value in probe(labelled(2000, 0), labelled(2000, 1)).items()}
    assert values["probe_mass_accuracy"] == 1.0
    assert values["probe_friction_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_chance"] == pytest.approx(0.25, abs=0.03)
