"""Exports have the released format, file by file, and read back unchanged."""

import errno
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import pytest

from cophy.dataset import images
from cophy.dataset.images import Images
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.export import export
from cophy.released.states import ReleasedSource
from cophy.scenario import Scenario
from cophy.scenario.rendering import NO_OBJECT, Backend, Frames, RenderSettings
from cophy.untrusted_files import count_frames
from tests.conftest import SCENARIOS, raising, settings, tiny_spec
from tests.released.indexing import make

PX = 32
GRID = ("mass", "friction", "restitution", "gravity_x", "gravity_y")


class Drawer:
    """A renderer that draws slot s as the columns s and s + 9, in an image of brightness 8 · (number of the frame)."""

    camera_seconds = 0.0

    def __init__(self, scenario: Scenario, *args: Any) -> None:
        self.scenario = scenario

    def __enter__(self) -> "Drawer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def render(self, positions: np.ndarray, quaternions: np.ndarray, *, presence: np.ndarray, **kwargs: Any) -> Frames:
        count = len(positions)
        rgb = np.broadcast_to(8 * np.arange(count, dtype=np.uint8)[:, None, None, None], (count, PX, PX, 3))
        segmentation = np.full((count, PX, PX), NO_OBJECT, dtype=np.uint8)
        for slot in np.flatnonzero(presence):
            segmentation[:, 4:8, [slot, slot + 9]] = slot
        return Frames(rgb, np.zeros((count, PX, PX), dtype=np.uint16), segmentation)


@pytest.fixture(scope="module")
def drawn(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Images]:
    """A scenario's tiny dataset with images that cost nothing to render, drawn once."""

    @cache
    def draw(name: str) -> Images:
        pictures = Images(States(tiny_spec(name), tiny_data), RenderSettings(["rgb", "segmentation"], PX, Backend.tiny))
        pictures.directory = tmp_path_factory.mktemp(f"pictures-{name}")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(images, "Renderer", Drawer)
            for shard in range(pictures.spec.num_shards):
                pictures.write(pictures.path(shard), shard, lambda count: None)
        pictures.write_manifest()
        return pictures

    return draw


@pytest.fixture(scope="module")
def exported(drawn: Callable[[str], Images], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The root of an export with clips, written once."""

    @cache
    def export_once(name: str) -> Path:
        root = tmp_path_factory.mktemp(f"export-{name}")
        export(drawn(name).states, drawn(name), root)
        return root

    return export_once


@pytest.fixture
def collisions(tiny_data: Path) -> States:
    return States(tiny_spec("collision"), tiny_data)


def imported(name: str, root: Path, split: str | None = None) -> dict[str, np.ndarray]:
    """The export read back, with the grid that it was generated with."""
    confounders = settings("train", f"scenario={name}").scenario.confounders
    grid = [f"scenario.confounders.{key}={[float(v) for v in getattr(confounders, key)]}" for key in GRID]
    config = settings("train", "source=cophy", f"scenario={name}", *grid, *([f"split={split}"] if split else []))
    (experiments,) = ReleasedSource("cophy", "", str(root)).experiment_sets(
        config.scenario, config.split, [SCENARIOS[name]], root.with_name(f"{root.name}-index")
    )
    return make(experiments).load()


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_export_reads_back_unchanged(name: str, drawn: Any, exported: Any) -> None:
    original, back = drawn(name).states.load(), imported(name, exported(name))
    frames = back["states"].shape[2]
    assert frames == (15 if name == "collision" else 30)
    np.testing.assert_array_equal(back["states"], original["states"][:, :, ::4][:, :, :frames])
    for array in ("presence", "split", "mass", "friction", "restitution", "gravity", "do_slot", "shape"):
        np.testing.assert_array_equal(back[array], original[array], err_msg=array)
    np.testing.assert_allclose(back["do_offset"], original["do_offset"], atol=1e-6)
    if name != "balls":
        np.testing.assert_array_equal(back["object_index"], original["object_index"])
    assert back["clip"].all()


@pytest.mark.parametrize(("name", "split"), [("blocktower", "3to3_unseen"), ("collision", "sphere_to_cylinder")])
def test_lists_of_unseen_experiments_read_back(name: str, split: str, drawn: Any, exported: Any) -> None:
    original, back = drawn(name).states.load(), imported(name, exported(name), split)
    config = settings("train", f"scenario={name}", f"split={split}")
    halves, scenario = config.split, config.scenario
    is_test = original["split"] == 2
    expected = np.where(is_test, halves.test.select(original, scenario), halves.train.select(original, scenario))
    np.testing.assert_array_equal(back["experiment"], np.flatnonzero(expected))
    np.testing.assert_array_equal(back["split"], original["split"][expected])


def test_states_only_read_back_without_clips(collisions: States, tmp_path: Path) -> None:
    folder = export(collisions, None, tmp_path / "root")
    assert {path.name for path in (folder / "0" / "ab").iterdir()} == {"states.npy", "colors.txt"}
    assert not imported("collision", tmp_path / "root")["clip"].any()


FILES = {
    "blocktower": {"confounders.npy", "gravity.txt"},
    "balls": {"confounders.npy", "explanations.txt"},
    "collision": {"confounders.npy", "explanations.txt"},
}
LISTS = {
    "blocktower": {f"blocktowerCF_{s}_3_{k}.txt" for s in ("train", "val", "test") for k in ("normal", "generalization")},
    "balls": {f"ballsCF_{s}_4.txt" for s in ("train", "val", "test")},
    "collision": {
        f"collisionCF_{s}_{k}.txt"
        for s in ("train", "val", "test")
        for k in ("normal", "moving_sphere", "moving_cylinder")
    },
}  # fmt: skip


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_file_has_the_released_format(name: str, drawn: Any, exported: Any) -> None:
    pictures, root = drawn(name), exported(name)
    folder = root / {"blocktower": "blocktowerCF/3", "balls": "ballsCF/4", "collision": "collisionCF"}[name]
    assert {path.name for path in (root / "splits").iterdir()} == LISTS[name]
    slots, frames = pictures.spec.scenario.num_slots, 15 if name == "collision" else 30
    arrays = pictures.states.load()
    for row in (0, 38):
        files = {str(path.relative_to(folder / str(row))) for path in (folder / str(row)).rglob("*") if path.is_file()}
        parts = {
            f"{part}/{file}"
            for part in ("ab", "cd")
            for file in ("rgb.mp4", "segm.mp4", "states.npy", "bboxes.npy", "colors.txt")
        }
        assert files == parts | FILES[name]
        for sequence, part in enumerate(("ab", "cd")):
            states, boxes = (np.load(folder / str(row) / part / f"{file}.npy") for file in ("states", "bboxes"))
            present = arrays["presence"][row, sequence]
            assert states.shape == (frames, slots, 13)
            assert not states[:, ~present].any()
            assert boxes.shape == (frames, slots, 4)
            assert boxes.dtype == np.float64  # the released loader divides in place
            scale = 224 / PX
            expected = [[slot * scale, 4 * scale, (slot + 9) * scale, 7 * scale] for slot in np.flatnonzero(present)]
            np.testing.assert_allclose(boxes[7, present], expected)
            assert not boxes[:, ~present].any()
            assert [count_frames(folder / str(row) / part / f"{clip}.mp4") for clip in ("rgb", "segm")] == [frames] * 2
            capture = cv2.VideoCapture(str(folder / str(row) / part / "rgb.mp4"))
            assert capture.get(cv2.CAP_PROP_FPS) == 5
            lines = (folder / str(row) / part / "colors.txt").read_text().splitlines()
            names = [line.split("color=")[1] for line in lines if "color=" in line]
            assert {list(pictures.spec.scenario.colors).index(color) for color in names} == set(np.flatnonzero(present))
            if name == "blocktower":
                assert "color=" not in lines[0]
                heights = states[0, [list(pictures.spec.scenario.colors).index(color) for color in names], 2]
                assert (np.diff(heights) > 0).all()
            if name == "collision":
                kinds = {line.split("type=")[1].split(" ")[0] for line in lines}
                assert kinds <= {"sphere", "cylinder_up", "cylinder_down"}
        confounders = np.load(folder / str(row) / "confounders.npy")
        assert confounders.shape == (slots, 2 if name == "blocktower" else 3)
        if name == "blocktower":
            text = (folder / str(row) / "gravity.txt").read_text()
            x, y = float(text.split("gravity_x=")[1].split(" ")[0]), float(text.split("gravity_y=")[1])
            assert [x, y] == arrays["gravity"][row, :2].tolist()


def test_an_export_resumes(collisions: States, tmp_path: Path) -> None:
    folder = export(collisions, None, tmp_path)
    before = (folder / "4" / "confounders.npy").stat().st_mtime_ns
    (folder / "5" / "explanations.txt").unlink()
    (folder / "5").rename(folder / ".5.tmp")  # as a kill leaves it
    export(collisions, None, tmp_path)
    assert (folder / "5" / "explanations.txt").exists()
    assert not list(folder.glob(".*.tmp"))
    assert (folder / "4" / "confounders.npy").stat().st_mtime_ns == before


def test_a_failed_export_leaves_no_partial_folder(
    collisions: States, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, "save", raising(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left"):
        export(collisions, None, tmp_path)
    assert not list(tmp_path.rglob("*.tmp"))


def test_states_only_are_not_mixed_into_an_export_with_clips(collisions: States, exported: Any) -> None:
    with pytest.raises(CophyError, match=r"holds other data than .* without images"):
        export(collisions, None, exported("collision"))


def test_an_export_overwrites_no_other_files(collisions: States, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign" / "collisionCF" / "0"
    foreign.mkdir(parents=True)
    with pytest.raises(CophyError, match="collisionCF holds other data"):
        export(collisions, None, tmp_path / "foreign")
    assert [path.name for path in (tmp_path / "foreign").rglob("*")] == ["collisionCF", "0"]
    (foreign.parent / "export.json").write_text("[" * 100_000)
    with pytest.raises(CophyError, match="collisionCF holds other data"):
        export(collisions, None, tmp_path / "foreign")
    lists = tmp_path / "lists" / "splits"
    lists.mkdir(parents=True)
    (lists / "collisionCF_val_normal.txt").write_text("17\n")
    with pytest.raises(CophyError, match=r"collisionCF_val_normal.txt is a list of other data"):
        export(collisions, None, tmp_path / "lists")
    assert not (tmp_path / "lists" / "collisionCF").exists()
