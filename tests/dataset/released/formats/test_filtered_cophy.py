"""Filtered-CoPhy is read as it is described."""

import re
from pathlib import Path

import numpy as np
import pytest

from cophy.scenario import Shape
from tests.dataset.released.indexing import LISTS, load
from tests.dataset.released.trees import BALL_COLORS, COLLISION_COLORS, TOWER_COLORS, filtered_tree

SLOTS = {"blocktower": TOWER_COLORS, "balls": BALL_COLORS, "collision": COLLISION_COLORS}


@pytest.mark.parametrize(("scenario", "task", "count", "split"), [("blocktower", "blocktowerCF", 4, "4to4"), ("balls", "ballsCF", 4, "4to4"), ("collision", "collisionCF", 2, "all")])  # fmt: skip
def test_filtered_cophy_is_read_at_five_hertz(tmp_path: Path, scenario: str, task: str, count: int, split: str) -> None:
    root = tmp_path / "CoPhy_112"
    filtered_tree(root, task, list("0123"), num_objects=count, clips=False)
    prefix = f"{task}_{count}" if scenario != "collision" else "collision"
    for ending, (part, ids) in zip(
        (".txt", "", ".txt"), LISTS.items(), strict=True
    ):  # as released: some without ending
        (root / f"{prefix}_{part}{ending}").write_text("\n".join(ids))
    arrays = load("filtered_cophy", scenario, root, split=split)
    for row, name in enumerate("0123"):
        slots = slots_of(root / task / name, scenario)
        for sequence, part in enumerate(("ab", "cd")):
            stored = np.load(root / task / name / part / "states.npy")[::5]
            np.testing.assert_allclose(arrays["states"][row, sequence][:, slots], stored, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(arrays["mass"][row, slots], np.load(root / task / name / "confounders.npy"))
        removed = scenario != "collision" and int(name) % 2
        assert arrays["presence"][row, 1].sum() == count - removed
    assert arrays["states"].shape[2] == (15 if scenario == "collision" else 30)
    assert set(arrays["friction"][arrays["presence"][:, 0]].tolist()) == {0.5}
    if scenario == "collision":  # the cylinder comes first in the files; here it is what moves in 0, the ball in 1
        for row, moving_first in ((0, [0, 1]), (1, [1, 0])):
            slots = slots_of(root / task / str(row), scenario)
            assert arrays["shape"][row, slots].tolist() == [Shape.CYLINDER, Shape.SPHERE]
            assert arrays["object_index"][row, slots].tolist() == moving_first


def slots_of(directory: Path, scenario: str) -> list[int]:
    names = re.findall(r"\w+", (directory / "COLORS.txt").read_text())
    return [SLOTS[scenario].index(name) for name in names]


@pytest.mark.parametrize(
    "text", ["__import__('os').mkdir('x')", "['red', 'red']", "[[1]]", "['pink']", "[" * 500, "{[]: 1}"]
)
def test_colors_are_read_as_a_literal(tmp_path: Path, text: str) -> None:
    root = tmp_path / "CoPhy_112"
    filtered_tree(root, "ballsCF", list("0123"), clips=False)
    for part, ids in LISTS.items():
        (root / f"ballsCF_4_{part}.txt").write_text("\n".join(ids))
    (root / "ballsCF/0/COLORS.txt").write_text(text)
    assert load("filtered_cophy", "balls", root)["experiment"].tolist() == [1, 2, 3]
