"""The confounder probe."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cophy.training.probe import Probed, probe, probe_accuracies, warn_if_constant
from cophy.types import Targets


def labelled(count: int, seed: int) -> Probed:
    """Return U that depends on mass but not on friction; the second of two slots is empty in every other experiment."""
    generator = torch.Generator().manual_seed(seed)
    classes = torch.randint(0, 2, (count, 2, 2), generator=generator)
    presence = torch.ones(count, 2, dtype=torch.bool)
    presence[::2, 1] = False
    noise = torch.randn(count, 2, 4, generator=generator)
    estimate = noise + 20 * classes[..., :1] * torch.tensor([1.0, 0, 0, 0])
    targets = Targets(
        position=torch.zeros(count, 1, 2, 3),
        stable=torch.zeros(count, 1, 2, dtype=torch.bool),
        presence=presence,
        initial=torch.zeros(count, 2, 3),
        observed_presence=presence,
        confounder_class=classes,
        pair=torch.arange(count) // 2,
        cell=torch.zeros(count, dtype=torch.long),
    )
    return Probed(torch.where(presence[..., None], estimate, 1e6), targets)


def test_the_probe_finds_what_is_there_and_nothing_else() -> None:
    values = {
        name: value.mean() for name, value in probe_accuracies(probe(labelled(2000, 0), labelled(2000, 1))).items()
    }
    assert values["probe_mass_accuracy"] == 1.0
    assert values["probe_friction_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_accuracy"] == pytest.approx(0.5, abs=0.04)
    assert values["probe_chance"] == pytest.approx(0.25, abs=0.03)


def test_the_classes_are_those_of_the_objects_of_ab() -> None:
    train, test = labelled(2000, 0), labelled(2000, 1)
    probed, present = probe(train, test), test.targets.observed_presence.numpy()
    true = test.targets.confounder_class.numpy()
    np.testing.assert_array_equal(probed["confounder_class"], np.where(present[..., None], true, -1))
    np.testing.assert_array_equal(probed["probe_mass"], np.where(present, true[..., 0], -1))
    assert (probed["probe_mass_and_friction"][..., 0] == probed["probe_mass"]).mean() > 0.99
    for name, shape in {"probe_friction": (2000, 2), "probe_mass_and_friction": (2000, 2, 2)}.items():
        assert probed[name].shape == shape
        assert ((probed[name].reshape(2000, 2, -1)[..., 0] >= 0) == present).all()
    seen = train.targets.confounder_class[train.targets.observed_presence].tolist()
    assert probed["probe_most_frequent"].tolist() == max(seen, key=seen.count)


def test_the_probe_of_a_constant_is_right() -> None:
    def constant(probed: Probed) -> Probed:
        classes = probed.targets.confounder_class * torch.tensor([1, 0])
        return probed._replace(targets=replace(probed.targets, confounder_class=classes))

    values = probe_accuracies(probe(constant(labelled(200, 0)), constant(labelled(200, 1))))
    assert values["probe_friction_accuracy"].mean() == 1.0
    assert values["probe_mass_accuracy"].mean() == 1.0


def test_an_estimate_that_is_the_same_for_all_objects_is_a_failed_training(caplog: pytest.LogCaptureFixture) -> None:
    probed = labelled(20, 0)
    warn_if_constant(probed)
    assert caplog.messages == []
    same = torch.where(probed.targets.presence[..., None], torch.tensor([1.0, -0.2, 0.0, 0.7]), 1e6)
    warn_if_constant(probed._replace(estimate=same + 1e-6 * torch.rand_like(same)))
    (message,) = caplog.messages
    assert "training.learning_rate" in message
