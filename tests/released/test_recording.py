"""Broken and malicious released experiments are named, and run no code."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import RunsCode
from tests.released.indexing import LISTS, make, states
from tests.released.trees import CoPhyTree, clip


def with_states(change: Any) -> Any:
    def damage(directory: Path) -> None:
        array = np.load(directory / "ab/states.npy")
        np.save(directory / "ab/states.npy", change(array))

    return damage


def at(index: Any, value: float) -> Any:
    def change(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return with_states(change)


def pickled(directory: Path) -> None:
    array = np.empty(1, dtype=object)
    array[0] = RunsCode(directory / "executed")
    np.save(directory / "confounders.npy", array, allow_pickle=True)


def bare_pickle(directory: Path) -> None:
    (directory / "confounders.npy").write_bytes(pickle.dumps(RunsCode(directory / "executed")))


def huge_header(directory: Path) -> None:
    with open(directory / "cd/states.npy", "wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**8, 1, 13)})
        file.write(bytes(30 * 4 * 13 * 8))


def odd_header(directory: Path) -> None:
    (directory / "confounders.npy").write_bytes(b"\x93NUMPY\x01\x00\x10\x00" + b"{[]: (1, 2L, 3  \n" + bytes(64))


def negative_axes(directory: Path) -> None:
    with open(directory / "cd/states.npy", "wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (-30, -4, 13)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(30 * 4 * 13 * 8))


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


DAMAGED = {
    "29 frames": (with_states(lambda a: a[:29]), "states.npy has 29 frames, not 30"),
    "columns": (with_states(lambda a: a[..., :7]), "shape (30, 4, 7)"),
    "nan": (at((3, 0, 0), np.nan), "numbers that are not finite"),
    "vanishing": (at((7,), 0.0), "an object is zero in some frames"),
    "wxyz": (with_states(lambda a: a * np.repeat([1, 2, 1], [3, 4, 6])), "not unit quaternions"),
    "too few": (with_states(lambda a: 0 * a), "AB holds 0 objects, not 3"),
    "pickled": (pickled, "not a .npy file of numbers (Object arrays"),
    "bare pickle": (bare_pickle, "not a .npy file"),
    "10 GB header": (huge_header, "not a .npy file of numbers"),
    "CD of another width": (lambda d: np.save(d / "cd/states.npy", np.load(d / "cd/states.npy")[:, :3]), "AB have 4 objects, of CD 3"),
    "odd header": (odd_header, "not a .npy file"),
    "negative axes": (negative_axes, "not a .npy file of numbers"),
    "beyond float32": (with_states(lambda a: 1e39 * a.astype(bool)), "states.npy holds 1e+39"),
    "many axes": (many_axes, "not a .npy file of numbers"),
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
    for number, (damage, _) in enumerate(DAMAGED.values(), start=4):
        directory = tree.tower(str(number))
        clip(directory / "short.mp4", 12, 5, 32)
        damage(directory)
    for name in "0123":
        tree.tower(name)
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    opened = make(states("cophy", "blocktower", tree.root))
    assert opened.load()["experiment"].tolist() == [0, 1, 2, 3]
    assert f"{len(DAMAGED)} of {len(DAMAGED) + 4} experiments are broken, the first is 4: " in caplog.text
    problems = (opened.directory / "broken.txt").read_text().splitlines()
    for number, ((case, (_, message)), problem) in enumerate(zip(DAMAGED.items(), problems, strict=True), start=4):
        assert problem.startswith(f"{number}: "), case
        assert message in problem, case
    assert not list(tree.root.rglob("executed"))
