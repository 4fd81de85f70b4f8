from pathlib import Path

import numpy as np

from cophy.dataset.difficulty import twin_differences
from cophy.dataset.states import States, sort_by_twins
from tests.conftest import tiny_spec


def test_towers_stand_or_fall_as_their_cell_says(tiny_data: Path) -> None:
    spec = tiny_spec("blocktower")
    arrays = sort_by_twins(States(spec, tiny_data).load(), spec)
    moved = np.linalg.norm(arrays["states"][..., :3] - arrays["states"][:, :, :1, :, :3], axis=-1).max(axis=(2, 3))
    words = np.where(moved < spec.scenario.fallen_distance, "stands", "falls").astype("U9")
    twins = words.reshape(-1, 2, 2)[:, ::-1].reshape(words.shape)
    words[(words[:, 0] == "falls") & (twins[:, 0] == "falls"), 0] = "both_fall"
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    np.testing.assert_array_equal(np.char.add(np.char.add(words[:, 0], "_"), words[:, 1]), names)


def test_where_a_falls_twice_it_falls_differently(tiny_data: Path) -> None:
    spec = tiny_spec("blocktower")
    arrays = sort_by_twins(States(spec, tiny_data).load(), spec)
    both_fall = np.char.startswith(np.array(spec.scenario.cells())[arrays["cell"]], "both_fall")
    assert (both_fall[::2] == both_fall[1::2]).all()
    assert (twin_differences(arrays)[both_fall[::2], 0] >= spec.scenario.min_difference).all()
    assert both_fall.mean() >= 0.75
