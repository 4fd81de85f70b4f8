"""Labels and outcomes of towers that do not agree are named."""

import numpy as np
import pytest

from cophy.audit.data import towers
from tests.dataset.audit.failing import failing


def test_a_flipped_label_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    flipped = arrays["cell"].copy()
    flipped[5] = (flipped[5] + 1) % 4
    assert "cells agree with the trajectories" in failing(
        towers(arrays | {"cell": flipped}, spec, spec.scenario.statics)
    )


def test_an_a_that_stands_whatever_the_confounders_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    changed = arrays["states"].copy()
    changed[:2, 0] = changed[:2, 0, :1]
    assert "no A stands under both twins' confounders" in failing(
        towers(arrays | {"states": changed}, spec, spec.scenario.statics)
    )


def test_twins_that_fall_alike_are_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    changed = arrays["states"].copy()
    changed[6:8, 1] = changed[6:8, 1, :1]  # both CD stand
    assert "twins have opposite outcomes of CD" in failing(
        towers(arrays | {"states": changed}, spec, spec.scenario.statics)
    )


def test_an_a_that_leaves_open_whether_c_stands_is_caught(tiny) -> None:
    """A straightened tower stands under all confounders, so that it tells nothing of them."""
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    changed = arrays["states"].copy()
    changed[:, 0, :, :, :2] = 0.0
    assert "on paper AB tells whether C stands" in failing(
        towers(arrays | {"states": changed}, spec, spec.scenario.statics)
    )


def test_a_block_that_should_fall_and_stays_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    changed = arrays["states"].copy()
    both_fall = np.char.startswith(np.array(spec.scenario.cells())[arrays["cell"]], "both_fall")
    top = (arrays["object_index"] == spec.num_objects - 1) & both_fall[:, None]
    rows, slots = np.nonzero(top)
    changed[rows, 0, :, slots] = changed[rows, 0, :1, slots]
    assert "in A all blocks fall that are sure to fall on paper" in failing(
        towers(arrays | {"states": changed}, spec, spec.scenario.statics)
    )
