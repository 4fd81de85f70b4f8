from pathlib import Path

import numpy as np

from cophy.dataset.store.states import States
from tests.conftest import tiny_spec


def test_towers_stand_or_fall_as_their_cell_says(tiny_data: Path) -> None:
    spec = tiny_spec("blocktower")
    arrays = States(spec, tiny_data).load()
    moved = np.linalg.norm(arrays["states"][..., :3] - arrays["states"][:, :, :1, :, :3], axis=-1).max(axis=(2, 3))
    words = np.where(moved < spec.scenario.fallen_distance, "stands", "falls")
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    np.testing.assert_array_equal(np.char.add(np.char.add(words[:, 0], "_"), words[:, 1]), names)
