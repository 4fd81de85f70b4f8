"""The audit passes what is sound and names what is not."""

import numpy as np
import pytest

from cophy.dataset.audit import audit
from tests.conftest import tiny_spec


def failing(arrays: dict, spec) -> set[str]:
    return {check.name for check in audit(arrays, spec) if not check.passed}


def test_a_sound_dataset_passes(tiny) -> None:
    spec, arrays = tiny
    assert not failing(arrays, spec)


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("states", "states are finite, empty slots zero"),
        ("split", "twins share all but confounders"),
        ("do_slot", "twins share all but confounders"),
        ("split", "train : val : test, by twin pair"),
    ],
)
def test_a_planted_fault_is_caught(tiny, name: str, check: str) -> None:
    spec, arrays = tiny
    changed = arrays[name].copy()
    changed[0] = np.nan if name == "states" else changed[0] + 1
    assert check in failing(arrays | {name: changed}, spec)


def test_a_flipped_label_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    flipped = arrays["stratum"].copy()
    flipped[5] = (flipped[5] + 1) % 4
    assert "labels agree with the trajectories" in failing(arrays | {"stratum": flipped}, spec)


def test_unbalanced_masses_are_caught(tiny) -> None:
    spec, arrays = tiny
    heavy = np.where(arrays["mass"] > 0, 10.0, 0.0)
    assert "share of mass" in failing(arrays | {"mass": heavy}, spec)


def test_tiny_strata_are_exactly_level() -> None:
    spec = tiny_spec("blocktower")
    assert spec.num_experiments % (2 * spec.scenario.num_cells()) == 0
