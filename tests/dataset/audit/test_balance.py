"""Shares that are not level, and shapes of another cell, are named."""

import numpy as np
import pytest

from cophy.audit.data import shapes, shares
from tests.dataset.audit.failing import failing


def test_a_collision_of_another_cell_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "collision":
        pytest.skip("collision only")
    for name in ("cell", "shape"):
        changed = arrays[name].copy()
        changed[5] = (changed[5] + 1) % 4 if name == "cell" else np.where(changed[5] > 0, 5 - changed[5], 0)
        assert "shapes are those of the cell" in failing(shapes(arrays | {name: changed}, spec))


def test_unbalanced_masses_are_caught(tiny) -> None:
    spec, arrays = tiny
    heavy = np.where(arrays["mass"] > 0, 10.0, 0.0)
    assert "share of mass" in failing(shares(arrays | {"mass": heavy}, spec))


def test_cells_that_are_not_those_of_the_blocks_are_caught(tiny) -> None:
    spec, arrays = tiny
    if len(spec.scenario.cells()) == 1:
        pytest.skip("one cell")
    changed = np.zeros_like(arrays["cell"])
    assert "share of cells" in failing(shares(arrays | {"cell": changed}, spec))
