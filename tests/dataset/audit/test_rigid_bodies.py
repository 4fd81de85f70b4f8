"""Places that rigid bodies cannot be in are named."""

import numpy as np

from cophy.audit.data import states
from tests.dataset.audit.failing import failing


def test_objects_in_one_place_are_caught(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    first, second = np.flatnonzero(arrays["presence"][0, 0])[:2]
    changed[0, 0, 9, first, :3] = changed[0, 0, 9, second, :3]
    assert "objects are apart, centres at least" in failing(states(arrays | {"states": changed}, spec))


def test_what_is_in_sight_is_a_square_for_balls_and_round_for_collisions(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    there = np.flatnonzero(arrays["presence"][0, 1])
    changed[0, 1, :, there, :2] = 0.9 * getattr(spec.scenario, "extent", 0.0)
    failed = "objects stay in sight" in failing(states(arrays | {"states": changed}, spec))
    assert failed == (spec.scenario.name == "collision")
