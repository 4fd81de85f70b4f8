"""CoPhy_224 and Filtered-CoPhy are read as they are described."""

import re
from pathlib import Path

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.released.formats import kind_of
from cophy.scenario import Shape
from cophy.untrusted_files import BrokenFileError, count_frames
from tests.conftest import settings
from tests.released.indexing import LISTS, load
from tests.released.trees import BALL_COLORS, COLLISION_COLORS, TOWER_COLORS, CoPhyTree, clip, filtered_tree


def test_a_huge_clip_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    clip(tmp_path / "rgb.mp4", 1, 5, 4112)
    with pytest.raises(BrokenFileError, match="has 4112 × 4112 pixels"):
        count_frames(tmp_path / "rgb.mp4")


def raw(tree: CoPhyTree, path: str) -> np.ndarray:
    return np.load(tree.root / path)


def test_towers_are_read_as_they_are_stored(towers: CoPhyTree) -> None:
    arrays = load("cophy", "blocktower", towers.root)
    assert arrays["split"].tolist() == [0, 0, 1, 2]
    for row, name in enumerate("0123"):
        for sequence, part in enumerate(("ab", "cd")):
            stored = raw(towers, f"blocktowerCF/3/{name}/{part}/states.npy")
            np.testing.assert_allclose(arrays["states"][row, sequence], stored, rtol=1e-6)
            assert arrays["presence"][row, sequence].tolist() == stored[0].any(axis=-1).tolist()
        confounders = raw(towers, f"blocktowerCF/3/{name}/confounders.npy")
        np.testing.assert_array_equal(arrays["mass"][row], confounders[:, 0])
        np.testing.assert_array_equal(arrays["friction"][row], confounders[:, 1])
        text = (towers.root / f"blocktowerCF/3/{name}/ab/colors.txt").read_text().split("color=")[1:]
        bottom_to_top = [TOWER_COLORS.index(color.strip()) for color in text]
        assert arrays["object_index"][row, bottom_to_top].tolist() == [0, 1, 2]
    np.testing.assert_array_equal(arrays["gravity"], [[0.5, -0.5, -10.0]] * 4)
    np.testing.assert_allclose(arrays["do_offset"], [[0, 0.25, 0], [0, 0, 0]] * 2, atol=1e-6)
    assert arrays["presence"].sum(axis=2).tolist() == [[3, 3], [3, 2]] * 2
    assert arrays["twin"].tolist() == [0, 1, 2, 3]  # there are no twins


def test_columns_of_cd_follow_its_colors_file(tree: CoPhyTree) -> None:
    """A file with a column per block, from which the middle block was removed."""
    directory, *_ = (tree.tower(name) for name in "0123")
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    slots = [TOWER_COLORS.index(text.strip()) for text in (directory / "ab/colors.txt").read_text().split("color=")[1:]]
    remaining = [slots[0], slots[2]]
    ab, cd = (np.load(directory / part / "states.npy") for part in ("ab", "cd"))
    np.save(directory / "ab/states.npy", ab[:, slots])
    np.save(directory / "cd/states.npy", cd[:, remaining])
    (directory / "cd/colors.txt").write_text(
        "from bottom to top\n" + "".join(f"color={TOWER_COLORS[s]}\n" for s in remaining)
    )
    states = load("cophy", "blocktower", tree.root)["states"][0]
    np.testing.assert_allclose(states[1][:, remaining], cd[:, remaining], rtol=1e-6)
    assert not states[1][:, slots[1]].any()


def test_noise_in_confounders_is_rounded_to_the_grid(tree: CoPhyTree) -> None:
    for name in "0123":
        tree.balls(name)
    tree.lists("ballsCF", "_4", **LISTS)
    arrays = load("cophy", "balls", tree.root)
    present = arrays["presence"][:, 0]
    assert set(arrays["friction"][present].tolist()) <= {np.float32(v) for v in (0.1, 0.5, 1)}
    stored = np.stack([raw(tree, f"ballsCF/4/{name}/confounders.npy") for name in "0123"])
    assert (stored == 0.0997877).any()
    np.testing.assert_allclose(arrays["restitution"], stored[..., 2], atol=1e-3)
    assert arrays["states"].shape == (4, 2, 30, len(BALL_COLORS), 13)


def test_the_moving_object_of_collisions_is_known(tree: CoPhyTree) -> None:
    for name in "0123":
        tree.collision(name, moving="cylinder_down" if name == "3" else "sphere")
    tree.lists("collisionCF", "_normal", **LISTS)
    tree.lists("collisionCF", "_moving_sphere", **LISTS)
    tree.lists("collisionCF", "_moving_cylinder", **LISTS)
    arrays = load("cophy", "collision", tree.root, split="sphere_to_cylinder")
    moving = arrays["object_index"] == 0
    assert arrays["shape"][moving].tolist() == [Shape.SPHERE] * 3 + [Shape.CYLINDER]
    assert arrays["states"].shape[2] == 15
    with pytest.raises(
        CophyError, match=r"_train_moving_cylinder.txt: in 2 of the listed .* moving object is no cylinder"
    ):
        load("cophy", "collision", tree.root, split="cylinder_to_sphere")


def test_unseen_splits_are_the_lists_called_generalization(towers: CoPhyTree) -> None:
    towers.lists("blocktowerCF", "_3_generalization", train=["3"], val=["1"], test=["0"])
    arrays = load("cophy", "blocktower", towers.root, split="3to3_unseen")
    assert dict(zip(arrays["experiment"].tolist(), arrays["split"].tolist(), strict=True)) == {0: 2, 1: 1, 3: 0}
    assert arrays["seen"].tolist() == [False, True, True]


def test_splits_without_released_lists_are_refused(towers: CoPhyTree) -> None:
    with pytest.raises(CophyError, match="3to3_seen does not go with blocktower: use 3to3, 3to3_unseen, 3to4, 4to4, 4"):
        load("cophy", "blocktower", towers.root, split="3to3_seen")
    with pytest.raises(CophyError, match=r"split=3to3_seen: CoPhy_224 has no test list of seen"):
        kind_of(settings("train", "split=3to3_seen").split)  # a custom split, scenario.task.splits


def test_confounders_that_the_tower_generator_omits_are_unknown(
    tree: CoPhyTree, caplog: pytest.LogCaptureFixture
) -> None:
    for name in "0123":
        tree.generated_tower(name, 4)
    tree.lists("blocktowerCF", "_4_normal", **LISTS)
    arrays = load("cophy", "blocktower", tree.root, split="4to4")
    heights = np.sort(arrays["states"][:, 0, 0, :, 2], axis=1)
    np.testing.assert_allclose(heights, [[0.5, 1.5, 2.5, 3.5]] * 4)
    assert arrays["presence"].sum(axis=2).tolist() == [[4, 4], [4, 3]] * 2
    assert np.isnan(arrays["mass"]).all()  # the files do not contain which mass belongs to which block
    assert np.isnan(arrays["gravity"][:, :2]).all()  # (0.5, 0.5) looks like gravity, but is two frictions
    assert "gravity counts as unknown" in caplog.text


def test_states_without_empty_columns_are_moved_to_their_slots(towers: CoPhyTree) -> None:
    known = load("cophy", "blocktower", towers.root)
    for name in "0123":
        for sequence, part in enumerate(("ab", "cd")):
            path = towers.root / f"blocktowerCF/3/{name}/{part}/states.npy"
            stored = np.load(path)
            order = np.argsort(known["object_index"][int(name)])[1:]
            np.save(path, stored[:, [slot for slot in order if known["presence"][int(name), sequence, slot]]])
    for name, array in load("cophy", "blocktower", towers.root).items():
        np.testing.assert_array_equal(array, known[name])


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
    if scenario == "collision":  # the cylinder is first in the files; it moves in 0, the ball in 1
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
def test_invalid_colors_break_only_their_experiment(tmp_path: Path, text: str) -> None:
    root = tmp_path / "CoPhy_112"
    filtered_tree(root, "ballsCF", list("0123"), clips=False)
    for part, ids in LISTS.items():
        (root / f"ballsCF_4_{part}.txt").write_text("\n".join(ids))
    (root / "ballsCF/0/COLORS.txt").write_text(text)
    assert load("filtered_cophy", "balls", root)["experiment"].tolist() == [1, 2, 3]
