"""Quantities of stored states, against cases computed by hand and against the search of the generator."""

from typing import Any

import numpy as np
import pytest

from cophy.dataset.difficulty import difficulty, further_than_twin, stands, true_margins, twin_differences
from cophy.dataset.shards import empty_arrays
from cophy.dataset.states import experiment_fields, trajectories_of
from cophy.scenario.physics import trajectory_distance
from tests.conftest import tiny_spec

SLOTS = [2, 0, 3]  # of the blocks, from the ground up
SPEC = tiny_spec("blocktower")


def straight_towers() -> dict[str, np.ndarray]:
    """Twins: A and C are one straight tower of three blocks of 1 kg, upright gravity, nothing moves."""
    arrays = empty_arrays(experiment_fields(SPEC, 2))
    arrays["object_index"][:] = -1
    arrays["gravity"][..., 2] = -10
    arrays["states"][..., SLOTS, 6] = 1
    for level, slot in enumerate(SLOTS):
        arrays["object_index"][:, slot], arrays["mass"][:, slot] = level, 1
        arrays["presence"][..., slot] = True
        arrays["states"][..., slot, 2] = level + 0.5
    return arrays


def test_margins_are_those_worked_out_by_hand() -> None:
    arrays = straight_towers()
    arrays["states"][:, 1, :, SLOTS[2], 0] += 0.3  # C: the top overhangs
    arrays["gravity"][1, 0] = 1
    arrays["mass"][1, SLOTS[2]] = 10
    upright = [0.5, 0.5 - 0.3]
    # the tower's centre of mass is 1.5 m high where blocks weigh the same, and (0.5 + 1.5 + 25) / 12 m otherwise
    height = (0.5 + 1.5 + 25) / 12
    tilted = [0.5 - 0.1 * height, 0.5 - max(0.3 + 0.1 * 0.5, 10 / 11 * 0.3 + 0.1 * (0.5 + 10 * 1.5) / 11)]
    tilted[1] = min(tilted[1], 0.5 - (10 / 12 * 0.3 + 0.1 * height))
    np.testing.assert_allclose(true_margins(arrays, SPEC), [upright, tilted], atol=1e-6)


def test_a_removed_block_weighs_nothing() -> None:
    arrays = straight_towers()
    arrays["presence"][:, 1, SLOTS[2]] = False
    arrays["states"][:, 1, :, SLOTS[2]] = 0
    arrays["gravity"][:, 1] = -1
    found = difficulty(arrays, SPEC)
    np.testing.assert_allclose(found["observed_margin"], 0.5 - 0.1 * 1.5, atol=1e-6)
    np.testing.assert_allclose(found["counterfactual_margin"], 0.5 - 0.1 * 1.0, atol=1e-6)
    assert np.isnan(found["displacement"]).all()


def test_differences_are_time_averages_of_the_object_that_differs_most() -> None:
    arrays = straight_towers()
    arrays["states"][1, 0, 60:, SLOTS[0], :2] = [3, 4]  # 5 m away for half of the time
    arrays["states"][1, 0, :, SLOTS[1], 0] += 1
    arrays["states"][0, 1, :, SLOTS[2], 2] += 0.25
    arrays["states"][0, 1, :, 1, 2] = 9  # an empty slot
    np.testing.assert_allclose(twin_differences(arrays), [[2.5, 0.25]])
    found = difficulty(arrays, SPEC)
    np.testing.assert_allclose(found["observed_difference"], [2.5, 2.5])
    np.testing.assert_allclose(found["counterfactual_difference"], [0.25, 0.25])


def test_displacements_and_names_are_those_stored() -> None:
    arrays = straight_towers()
    arrays["do_offset"][1, :2] = [0.3, -0.4]
    arrays["do_operation"][1], arrays["cell"][1] = 1, 3
    found = difficulty(arrays, SPEC)
    np.testing.assert_allclose(found["displacement"], [0, 0.5])
    assert found["do_operation"].tolist() == ["displace_x", "displace_y"]
    assert found["cell"].tolist() == ["stands_stands", "falls_stands"]


def test_generated_twins_differ_as_the_search_measured(tiny: Any) -> None:
    spec, arrays = tiny
    found = difficulty(arrays, spec)
    assert {len(values) for values in found.values()} == {spec.num_experiments}
    for row in range(0, spec.num_experiments, 2):
        twins = zip(trajectories_of(arrays, row), trajectories_of(arrays, row + 1), strict=True)
        expected = [trajectory_distance(*both) for both in twins]
        own = [found[name][row] for name in ("observed_difference", "counterfactual_difference")]
        np.testing.assert_allclose(own, expected, rtol=1e-5)


@pytest.mark.parametrize("tiny", ["blocktower"], indirect=True)
def test_generated_towers_stand_where_their_margin_is_positive(tiny: Any) -> None:
    spec, arrays = tiny
    margins = true_margins(arrays, spec)
    words = np.where(margins > 0, "stands", "falls")
    cells = [name.replace("both_fall", "falls") for name in difficulty(arrays, spec)["cell"].tolist()]
    assert cells == ["_".join(pair) for pair in words]
    assert np.abs(margins).min() >= spec.scenario.min_margin - 1e-6


def two_twins(moved_m: float) -> dict[str, np.ndarray]:
    """Return twins with one object, which moves only in the second twin's CD."""
    states = np.zeros((2, 2, 3, 1, 13))
    states[1, 1, 1:, 0, 0] = moved_m
    return {"states": states, "presence": np.ones((2, 2, 1), dtype=bool), "twin": np.array([0, 0])}


def test_a_tower_stands_while_no_block_leaves_its_place() -> None:
    assert stands(two_twins(0.09), fallen_distance=0.1).tolist() == [[True, True], [True, True]]
    assert stands(two_twins(0.11), fallen_distance=0.1).tolist() == [[True, True], [True, False]]


def test_objects_go_further_than_under_the_confounders_of_the_twin() -> None:
    assert further_than_twin(two_twins(1.0)).tolist() == [[False, False], [False, True]]
