"""Places that rigid bodies cannot be in are named."""

import numpy as np

from cophy.dataset.audit.rigid_bodies import states
from tests.dataset.audit.failing import failing


def test_objects_in_one_place_are_caught(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    first, second = np.flatnonzero(arrays["presence"][0, 0])[:2]
    changed[0, 0, 9, first, :3] = changed[0, 0, 9, second, :3]
    assert "objects are apart, centres at least" in failing(states(arrays | {"states": changed}, spec))
