"""First frames of one split that are those of another are named."""

import numpy as np

from cophy.audit.data import SAME_TOLERANCE_M, geometries
from tests.dataset.audit.failing import failing


def test_a_geometry_of_another_split_is_caught_whatever_its_colours(tiny) -> None:
    """A of a training experiment, its objects in other slots and in another order, a tenth of the tolerance aside."""
    spec, arrays = tiny
    assert not failing(geometries(arrays, spec.num_objects))
    train, test = (np.flatnonzero(arrays["split"] == split)[:2] for split in (0, 2))
    copied = {name: array.copy() for name, array in arrays.items()}
    for name in ("object_index", "shape"):
        copied[name][test] = np.roll(arrays[name][train], 1, axis=1)
    index = copied["object_index"][test]
    copied["object_index"][test] = np.where(index < 0, index, spec.num_objects - 1 - index)
    copied["presence"][test, 0] = np.roll(arrays["presence"][train, 0], 1, axis=1)
    copied["states"][test, 0] = np.roll(arrays["states"][train, 0], 1, axis=2)
    copied["states"][test, 0, ..., :2] += SAME_TOLERANCE_M / 10
    assert "no A or C of one split in another" in failing(geometries(copied, spec.num_objects))
    copied["states"][test, 0, ..., :2] += 0.05
    assert not failing(geometries(copied, spec.num_objects))
