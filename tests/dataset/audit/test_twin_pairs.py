"""Planted faults in twins are named."""

from collections.abc import Callable

import numpy as np
import pytest

from cophy.audit.data import slots_in_order, states, twins
from tests.dataset.audit.failing import failing


@pytest.mark.parametrize(
    ("name", "checks", "line"),
    [
        ("split", twins, "twins share all but confounders"),
        ("do_slot", twins, "twins share all but confounders"),
        ("split", twins, "train : val : test, by twin pair"),
        ("cell", twins, "confounders and do-operation are those of the index"),
        ("configuration", states, "confounders are those of the configuration"),
        ("mass", states, "confounders are those of the configuration"),
        ("gravity", states, "confounders are those of the configuration"),
        ("do_offset", states, "C is A under the do-operation"),
    ],
)
def test_a_planted_fault_is_caught(tiny, name: str, checks: Callable, line: str) -> None:
    spec, arrays = tiny
    changed = arrays[name].copy()
    changed[0] = changed[0] + 1
    assert line in failing(checks(arrays | {name: changed}, spec))


@pytest.mark.parametrize(
    ("name", "place", "value", "line"),
    [
        ("seen", (5,), None, "confounders and do-operation are those of the index"),
        ("gravity", (5, 2), -5.0, "confounders are those of the configuration"),
        ("mass", None, 10.0, "states are finite, empty slots zero"),
    ],
)
def test_a_fault_in_one_second_twin_is_caught(tiny, name: str, place: tuple | None, value: float, line: str) -> None:
    spec, arrays = tiny
    changed = arrays[name].copy()
    place = place or (5, int(np.argmin(arrays["object_index"][5])))
    changed[place] = ~changed[place] if value is None else value
    assert line in failing([*states(arrays | {name: changed}, spec), *twins(arrays | {name: changed}, spec)])


def test_a_seen_combination_that_is_held_out_too_is_caught_however_it_is_turned_and_scaled(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    line = "masses × gravity seen and unseen (†), up to symmetry and scale"
    assert line not in failing(twins(arrays, spec))
    slots = slots_in_order(arrays, spec.num_objects)
    seen, unseen = (int(np.flatnonzero(arrays["seen"] == half)[0]) for half in (True, False))
    mass, gravity = arrays["mass"].copy(), arrays["gravity"].copy()
    mass[unseen, slots[unseen]] = 10 * arrays["mass"][seen, slots[seen]]
    gravity[unseen, :2] = -arrays["gravity"][seen, 1::-1]
    assert line in failing(twins(arrays | {"mass": mass, "gravity": gravity}, spec))
