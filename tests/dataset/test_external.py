"""Released layouts are read as they are described, whatever varies; what would silently be wrong is refused by name."""

import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.external import Clips, ExternalStates
from cophy.dataset.frames import FrameDataset
from cophy.dataset.source import Source
from cophy.errors import CophyError
from cophy.scenario import Shape
from cophy.scenario.rendering import Backend, RenderSettings
from tests.conftest import settings
from tests.dataset.trees import BALL_COLORS, COLLISION_COLORS, TOWER_COLORS, CoPhyTree, clip, filtered_tree

SLOTS = {"blocktower": TOWER_COLORS, "balls": BALL_COLORS, "collision": COLLISION_COLORS}
LISTS = {"train": ["0", "1"], "val": ["2"], "test": ["3"]}


def states(source: str, scenario: str, root: Path, split: str | None = None, num_objects: int | None = None) -> Any:
    """An index in `<root>-data`, not yet made."""
    chosen = settings("train", f"source={source}", f"scenario={scenario}", *([f"split={split}"] if split else []))
    where = Source(source, "", str(root))
    return where.states(
        chosen.scenario, num_objects or chosen.split.train.num_objects, split=chosen.split, size=chosen.size, seed=0,
        data_dir=root.with_name(f"{root.name}-data"),
    )  # fmt: skip


def make(opened: ExternalStates) -> ExternalStates:
    """The index, made in this process."""
    opened.directory.mkdir(parents=True, exist_ok=True)
    opened.write(opened.path(0), 0, lambda count: None)
    opened.write_manifest()
    return opened


def load(*args: Any, **kwargs: Any) -> dict[str, np.ndarray]:
    return make(states(*args, **kwargs)).load()


@pytest.fixture
def tree(tmp_path: Path) -> CoPhyTree:
    return CoPhyTree(tmp_path / "CoPhy_224")


@pytest.fixture
def towers(tree: CoPhyTree) -> CoPhyTree:
    """Four towers of three, ids 0 to 3, one per list but for training."""
    for name in "0123":
        tree.tower(name)
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    return tree


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
    assert arrays["twin"].tolist() == [0, 1, 2, 3]  # nobody is anybody's twin


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


def test_collisions_know_what_moves(tree: CoPhyTree) -> None:
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


def test_what_the_tower_generator_leaves_out_is_unknown(tree: CoPhyTree, caplog: pytest.LogCaptureFixture) -> None:
    for name in "0123":
        tree.generated_tower(name, 4)
    tree.lists("blocktowerCF", "_4_normal", **LISTS)
    arrays = load("cophy", "blocktower", tree.root, split="4to4")
    heights = np.sort(arrays["states"][:, 0, 0, :, 2], axis=1)
    np.testing.assert_allclose(heights, [[0.5, 1.5, 2.5, 3.5]] * 4)
    assert arrays["presence"].sum(axis=2).tolist() == [[4, 4], [4, 3]] * 2
    assert np.isnan(arrays["mass"]).all()  # which mass is whose, the files do not tell
    assert np.isnan(arrays["gravity"][:, :2]).all()  # (0.5, 0.5) would pass for gravity, and is two frictions
    assert "gravity counts as unknown" in caplog.text


def test_one_gravity_that_is_none_discredits_all(towers: CoPhyTree) -> None:
    (towers.root / "blocktowerCF/3/2/gravity.txt").write_text("gravity_x=1.0 gravity_y=0.5")
    arrays = load("cophy", "blocktower", towers.root)
    assert np.isnan(arrays["gravity"][:, :2]).all()
    assert not np.isnan(arrays["mass"]).any()


def test_unpadded_states_with_colors_find_their_slots(towers: CoPhyTree) -> None:
    known = load("cophy", "blocktower", towers.root)
    for name in "0123":
        for sequence, part in enumerate(("ab", "cd")):
            path = towers.root / f"blocktowerCF/3/{name}/{part}/states.npy"
            stored = np.load(path)
            order = np.argsort(known["object_index"][int(name)])[1:]
            np.save(path, stored[:, [slot for slot in order if known["presence"][int(name), sequence, slot]]])
    for name, array in load("cophy", "blocktower", towers.root).items():
        np.testing.assert_array_equal(array, known[name])


def test_empty_folders_are_passed_over(towers: CoPhyTree, caplog: pytest.LogCaptureFixture) -> None:
    (towers.root / "blocktowerCF/3/17").mkdir()
    caplog.set_level("INFO")
    opened = make(states("cophy", "blocktower", towers.root))
    assert len(opened.load()["split"]) == 4
    assert "1 empty folders" in caplog.text
    assert not (opened.directory / "broken.txt").exists()


class Payload:
    """Leaves a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def with_states(change: Any) -> Any:
    def spoil(directory: Path) -> None:
        array = np.load(directory / "ab/states.npy")
        np.save(directory / "ab/states.npy", change(array))

    return spoil


def at(index: Any, value: float) -> Any:
    def change(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return with_states(change)


def pickled(directory: Path) -> None:
    array = np.empty(1, dtype=object)
    array[0] = Payload(directory / "executed")
    np.save(directory / "confounders.npy", array, allow_pickle=True)


def bare_pickle(directory: Path) -> None:
    (directory / "confounders.npy").write_bytes(pickle.dumps(Payload(directory / "executed")))


def huge_header(directory: Path) -> None:
    with open(directory / "cd/states.npy", "wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**8, 1, 13)})
        file.write(bytes(30 * 4 * 13 * 8))


def odd_header(directory: Path) -> None:
    (directory / "confounders.npy").write_bytes(b"\x93NUMPY\x01\x00\x10\x00" + b"{[]: (1, 2L, 3  \n" + bytes(64))


def many_axes(directory: Path) -> None:
    with open(directory / "confounders.npy", "wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (1,) * 100}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(8))


def linked(directory: Path) -> None:
    (directory / "confounders.npy").unlink()
    (directory / "confounders.npy").symlink_to("/dev/zero")


def linked_folder(directory: Path) -> None:
    (directory / "ab").rename(directory / "elsewhere")
    (directory / "ab").symlink_to(directory / "elsewhere")


def playlist(directory: Path) -> None:
    (directory / "ab/rgb.mp4").write_text("#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n")


SPOILT = {
    "29 frames": (with_states(lambda a: a[:29]), "states.npy has 29 frames, not 30"),
    "columns": (with_states(lambda a: a[..., :7]), "shape (30, 4, 7)"),
    "nan": (at((3, 0, 0), np.nan), "numbers that are not finite"),
    "vanishing": (at((7,), 0.0), "an object is zero in some frames"),
    "wxyz": (with_states(lambda a: a * np.repeat([1, 2, 1], [3, 4, 6])), "not unit quaternions"),
    "too few": (with_states(lambda a: 0 * a), "AB holds 0 objects, not 3"),
    "pickled": (pickled, "pickled objects are not read"),
    "bare pickle": (bare_pickle, "not a .npy file"),
    "10 GB header": (huge_header, "says float64 (100000000, 1, 13)"),
    "CD of another width": (lambda d: np.save(d / "cd/states.npy", np.load(d / "cd/states.npy")[:, :3]), "AB have 4 objects, of CD 3"),
    "odd header": (odd_header, "not a .npy file"),
    "many axes": (many_axes, "says float64 (1, 1, "),
    "link": (linked, "confounders.npy is a link"),
    "linked folder": (linked_folder, "links in the place of ab"),
    "playlist": (playlist, "not an MP4 file"),
    "short clip": (lambda d: (d / "cd/rgb.mp4").write_bytes((d / "short.mp4").read_bytes()), "cd/rgb.mp4 has 12 frames"),
    "off the grid": (lambda d: np.save(d / "confounders.npy", np.full((4, 2), 3.0)), "mass 3 is not among 1, 10"),
    "gone": (lambda d: (d / "cd/states.npy").unlink(), "cd/states.npy cannot be read"),
    "gravity": (lambda d: (d / "gravity.txt").write_text("gravity_x=a gravity_y=b"), "gravity.txt is not"),
}  # fmt: skip


def test_broken_experiments_are_listed_and_the_others_are_read(
    tree: CoPhyTree, caplog: pytest.LogCaptureFixture
) -> None:
    for number, (spoil, _) in enumerate(SPOILT.values(), start=4):
        directory = tree.tower(str(number))
        clip(directory / "short.mp4", 12, 5, 32)
        spoil(directory)
    for name in "0123":
        tree.tower(name)
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    opened = make(states("cophy", "blocktower", tree.root))
    assert opened.load()["experiment"].tolist() == [0, 1, 2, 3]
    assert f"{len(SPOILT)} of {len(SPOILT) + 4} experiments are broken, the first is 4: " in caplog.text
    problems = (opened.directory / "broken.txt").read_text().splitlines()
    for number, ((case, (_, message)), problem) in enumerate(zip(SPOILT.items(), problems, strict=True), start=4):
        assert problem.startswith(f"{number}: "), case
        assert message in problem, case
    assert not list(tree.root.rglob("executed"))


def test_when_all_are_broken_the_first_is_named(towers: CoPhyTree) -> None:
    for name in "0123":
        np.save(towers.root / f"blocktowerCF/3/{name}/confounders.npy", np.full((4, 2), 3.0))
    with pytest.raises(
        CophyError, match=r"4 of 4 experiments are broken, the first is 0: mass 3 .*scenario.confounders.mass"
    ):
        load("cophy", "blocktower", towers.root)


@pytest.mark.parametrize("line", ["../../etc/passwd", "/etc/passwd", "..", "0/ab", "a b", "x" * 5 + "\x00"])
def test_a_list_that_leads_elsewhere_is_refused_before_anything_is_written(towers: CoPhyTree, line: str) -> None:
    (towers.root / "splits/blocktowerCF_val_3_normal.txt").write_text(f"2\n{line}\n")
    with pytest.raises(CophyError, match=r"blocktowerCF_val_3_normal.txt, line 2: .* is not the id of an experiment"):
        states("cophy", "blocktower", towers.root)
    assert not towers.root.with_name("CoPhy_224-data").exists()


def test_lists_that_share_ids_or_are_missing_are_refused(towers: CoPhyTree) -> None:
    towers.lists("blocktowerCF", "_3_normal", test=["1", "3"])
    with pytest.raises(CophyError, match="share 1 ids, 1 for one"):
        states("cophy", "blocktower", towers.root)
    (towers.root / "splits/blocktowerCF_test_3_normal.txt").unlink()
    with pytest.raises(CophyError, match=r"there is no blocktowerCF_test_3_normal.txt in .*source.splits="):
        states("cophy", "blocktower", towers.root)
    with pytest.raises(CophyError, match=r"no ballsCF_train_4.txt"):
        states("cophy", "balls", towers.root)


def test_an_index_is_made_once_and_again_when_experiments_come(towers: CoPhyTree) -> None:
    opened = states("cophy", "blocktower", towers.root)
    generation.make(opened, workers=1)
    (towers.root / "blocktowerCF/3/0/ab/states.npy").unlink()  # read no more
    assert states("cophy", "blocktower", towers.root).is_finished()
    assert len(states("cophy", "blocktower", towers.root).load()["split"]) == 4
    towers.tower("4")
    assert not states("cophy", "blocktower", towers.root).is_finished()


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


@pytest.mark.parametrize("text", ["__import__('os').mkdir('x')", "['red', 'red']", "[[1]]", "['pink']", "[" * 500])
def test_colors_are_read_as_a_literal(tmp_path: Path, text: str) -> None:
    root = tmp_path / "CoPhy_112"
    filtered_tree(root, "ballsCF", list("0123"), clips=False)
    for part, ids in LISTS.items():
        (root / f"ballsCF_4_{part}.txt").write_text("\n".join(ids))
    (root / "ballsCF/0/COLORS.txt").write_text(text)
    assert load("filtered_cophy", "balls", root)["experiment"].tolist() == [1, 2, 3]


@pytest.mark.parametrize("source", ["cophy", "filtered_cophy"])
def test_frames_are_those_of_their_states(tmp_path: Path, source: str) -> None:
    root = tmp_path / "root"
    if source == "cophy":
        tree = CoPhyTree(root)
        for name in "0123":
            tree.balls(name)
        tree.lists("ballsCF", "_4", **LISTS)
    else:
        filtered_tree(root, "ballsCF", list("0123"))
        for part, ids in LISTS.items():
            (root / f"ballsCF_4_{part}").write_text("\n".join(ids))
    missing = root / "ballsCF" / ("4/1" if source == "cophy" else "1") / "cd/rgb.mp4"
    missing.unlink()  # a clip that is not there is not shown
    opened = states(source, "balls", root)
    make(opened)
    arrays = opened.load()
    frames = FrameDataset([(Clips(opened), arrays)], split="train", resolution=16)
    assert len(frames) == 3 * 30
    for item in (0, 3, 7, 12, 89):
        _, row, sequence, time = frames.index[item]
        seen = frames[item]
        assert abs(float(seen.image.float().mean()) - 8 * time) < 4
        np.testing.assert_array_equal(seen.position, arrays["states"][row, sequence, time, :, :3])
    assert set(frames.pairs.tolist()) == {0, 1}
    estimates = Estimates(Clips(opened), Brightness())
    estimates.directory.mkdir()
    estimates.write(estimates.path(0), 0, lambda count: None)
    estimates.write_manifest()
    position = estimates.load()["position"]
    np.testing.assert_allclose(position[2, 1, :, 0, 0], 8 * np.arange(30), atol=3.9)
    assert not position[1, 1].any()


class Brightness:
    """Sees how bright a frame is, and calls that x."""

    name, source = "brightness", Path("brightness.ckpt")
    render = RenderSettings(["rgb"], 16, Backend.tiny)

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position = np.zeros((len(rgb), len(BALL_COLORS), 3))
        position[..., 0] = rgb.mean(axis=(1, 2, 3))[:, None]
        return position, np.ones((len(rgb), len(BALL_COLORS)))
