"""An AB that does not tell CD is named."""

from dataclasses import replace

import numpy as np
import pytest

from cophy.audit.simulated import _line, identifiability
from cophy.dataset.fields import to_arrays
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Simulator
from tests.conftest import tiny_spec


@pytest.fixture(scope="module")
def few_configurations() -> DatasetSpec:
    """Towers without friction and without gravity along y: 24 configurations, not 576."""
    spec = tiny_spec("blocktower")
    grid = replace(spec.scenario.confounders, friction=[1], gravity_y=[0])
    return replace(spec, scenario=replace(spec.scenario, confounders=grid))


@pytest.fixture(scope="module")
def first_pairs(few_configurations: DatasetSpec) -> dict[str, np.ndarray]:
    with Simulator() as simulator:
        return to_arrays(
            [
                experiment
                for pair in range(2)
                for experiment in few_configurations.scenario.twin_pair(3, data_seed=0, pair=pair, simulator=simulator)
            ],
            range(4),
            few_configurations,
        )


def test_how_a_tower_falls_tells_what_becomes_of_c(few_configurations: DatasetSpec, first_pairs: dict) -> None:
    checks = list(identifiability(first_pairs, few_configurations, pairs=2))
    assert [check.found.split(" ≥")[0] for check in checks] == ["in 100.0% of 4 experiments"] * 2
    assert all(check.passed for check in checks)


def test_a_limit_is_lowered_by_chance_alone() -> None:
    """Three standard deviations of a share of 98 % are 6.6 points in 40 experiments, 2.1 in 400 and 0.7 in 4,000."""
    for count, passing, failing in ((40, 0.92, 0.91), (400, 0.96, 0.955), (4000, 0.974, 0.972)):
        assert _line("", passing, 0.98, count, enumerated=True).passed
        assert not _line("", failing, 0.98, count, enumerated=True).passed


def test_an_ab_that_tells_nothing_is_caught(few_configurations: DatasetSpec, first_pairs: dict) -> None:
    """Towers set straight stand whatever their confounders; displaced blocks fall one way or the other."""
    arrays = {name: array.copy() for name, array in first_pairs.items()}
    arrays["states"][:, :, :, :, :2] = 0.0
    arrays["states"][:, 0] = arrays["states"][:, 0, :1]
    arrays["states"][..., 3:13] = np.where(arrays["presence"][:, :1, None, :, None], [0, 0, 0, 1, 0, 0, 0, 0, 0, 0], 0)
    arrays["presence"][:, 1] = arrays["presence"][:, 0]
    arrays["do_slot"] = arrays["object_index"].argmax(axis=1)
    arrays["do_offset"] = np.tile(np.float32([0.47, 0.47, 0.0]), (4, 1))
    for row in range(4):
        scene = scene_of(arrays, row, few_configurations.scenario)
        after = do_operation_of(arrays, row, few_configurations.scenario).apply(scene)
        with Simulator() as simulator:
            arrays["states"][row, 1] = few_configurations.scenario.simulate(simulator, after).states
    assert not any(check.passed for check in identifiability(arrays, few_configurations, pairs=1))
