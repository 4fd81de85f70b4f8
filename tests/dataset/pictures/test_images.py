"""Pictures on disk: lossless, resumable, and of the states beside them."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.frames import FrameDataset
from cophy.dataset.images import Images, bounding_boxes
from cophy.drawing.sheets import render_sequence
from cophy.errors import CophyError
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Backend, Frames, Renderer
from tests.conftest import ROOT
from tests.dataset.copies import SPEC, digests
from tests.dataset.pictures.rendered import RENDER, copy_images, images


def test_what_is_stored_is_what_was_drawn(rendered: Images) -> None:
    arrays = rendered.states.load()
    with Renderer(SPEC.scenario, RENDER.resolution) as renderer, h5py.File(rendered.path(1), "r") as file:
        for experiment, sequence in ((24, 0), (31, 1)):
            drawn = render_sequence(renderer, arrays, experiment, sequence, slice(None))
            for name in MODALITIES:
                np.testing.assert_array_equal(file[name][experiment - 24, sequence], getattr(drawn, name))


def start_rendering(data_dir: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, str(ROOT / "src" / "generate.py"), "scenario=collision", "size=tiny", "workers=2"]
    command += [f"data_dir={data_dir}", "render=all", f"render.resolution={RENDER.resolution}"]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def empty(copied: Images) -> None:
    for path in copied.directory.iterdir():
        path.unlink()


def test_a_killed_rendering_continues_to_the_same_bytes(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    empty(copied)
    process = start_rendering(tmp_path)
    while not any(copied.path(shard).exists() for shard in range(SPEC.num_shards)):
        assert process.poll() is None, "rendering ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    generation.make(copied, workers=2)
    assert digests(copied.directory) == digests(rendered.directory)


@pytest.mark.slow
def test_ten_kills_at_random_moments_change_no_byte(rendered: Images, tmp_path: Path) -> None:
    copied, rng = copy_images(rendered, tmp_path), np.random.default_rng(0)
    empty(copied)
    for _ in range(10):
        process = start_rendering(tmp_path)
        time.sleep(rng.uniform(0.5, 6.0))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        for shard in range(SPEC.num_shards):
            if copied.path(shard).exists() and rng.random() < 0.5:
                copied.path(shard).unlink()  # so that there is always something left to do
    generation.make(copied, workers=2)
    assert digests(copied.directory) == digests(rendered.directory)
    assert not list(copied.directory.glob("*.tmp"))


def test_a_damaged_shard_is_named_and_only_it_is_drawn_again(
    rendered: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy_images(rendered, tmp_path)
    path, untouched = copied.path(1), copied.path(0).stat().st_mtime_ns
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    generation.make(copied, workers=1)
    assert "shard-00001.h5 is damaged (its checksum" in caplog.text
    assert "shard-00000.h5 is damaged" not in caplog.text
    assert copied.path(0).stat().st_mtime_ns == untouched
    assert digests(copied.directory) == digests(rendered.directory)


def test_a_pixel_that_was_changed_is_not_read(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    with h5py.File(copied.path(0), "r") as file:
        chunk = file["rgb"].id.get_chunk_info(0)
    content = bytearray(copied.path(0).read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 255
    copied.path(0).write_bytes(content)
    with (
        pytest.raises(CophyError, match=r"shard-00000\.h5 is damaged .* render=all .* render\.resolution=16"),
        copied.explained(0),
    ):
        h5py.File(copied.path(0), "r")["rgb"][0, 0, 0]


def test_pictures_of_other_states_are_drawn_again(
    rendered: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy_images(rendered, tmp_path)
    (copied.directory / "manifest.json").unlink()
    with h5py.File(copied.path(0), "r+") as file:
        file.attrs["states_sha256"] = "0" * 64
    generation.make(copied, workers=1)
    assert "shard-00000.h5 is damaged (it was made from other files" in caplog.text


def test_pictures_of_other_states_are_not_read(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    with h5py.File(copied.path(0), "r+") as file:
        file.attrs["states_sha256"] = "0" * 64
    frames = FrameDataset([(copied, copied.states.load())], split="train", resolution=16)
    with pytest.raises(CophyError, match=r"shard-00000\.h5 is damaged \(it was made from other files"):
        frames[0]


def test_rgb_that_another_set_holds_is_not_rendered_again(rendered: Images, tmp_path: Path) -> None:
    """And has the bytes that a rendering of its own has."""
    copied = copy_images(rendered, tmp_path)
    rgb = copied.states.frames(replace(RENDER, modalities=["rgb"]))
    rgb.ensure(workers=1)
    assert not rgb.directory.exists()
    arrays = copied.states.load()
    read, pictures = rgb.reader(arrays), rgb.pictures(arrays, ["rgb"])
    clips = {(row, sequence): clip for row, sequence, _, clip in rgb.sequences(1)}
    found = {(row, sequence): pictures(24 + row)["rgb"][sequence] for row, sequence in clips}
    frame = read(30, 1, 7)

    generation.make(rgb, workers=2)
    assert rgb.or_more() is rgb
    with h5py.File(rgb.path(1), "r") as file:
        assert set(file) == {"rgb", "boxes"}
        np.testing.assert_array_equal(frame, file["rgb"][6, 1, 7])
        for (row, sequence), clip in clips.items():
            np.testing.assert_array_equal(clip, file["rgb"][row, sequence])
            np.testing.assert_array_equal(found[row, sequence], clip)


@pytest.mark.parametrize("changes", [{"resolution": 20}, {"backend": Backend.egl}])
def test_pictures_of_another_size_or_renderer_are_no_substitute(
    rendered: Images, tmp_path: Path, changes: dict[str, Any]
) -> None:
    copied = copy_images(rendered, tmp_path)
    other = copied.states.frames(replace(RENDER, modalities=["rgb"], **changes))
    assert other.or_more() is other


def test_a_set_with_fewer_modalities_is_no_substitute(rendered: Images, tmp_path: Path) -> None:
    few = images(tmp_path).states.frames(replace(RENDER, modalities=["rgb", "depth"]))
    copied = copy_images(rendered, tmp_path)
    assert few.or_more().directory == copied.directory
    copied.directory.joinpath("manifest.json").unlink()
    assert few.or_more() is few


def test_boxes_enclose_what_is_seen_of_each_object() -> None:
    segmentation = np.full((1, 6, 6), NO_OBJECT, dtype=np.uint8)
    segmentation[0, 1:3, 2:5] = 0
    segmentation[0, 5, 5] = 2
    boxes = bounding_boxes(Frames(np.zeros(0), np.zeros(0), segmentation), 3)
    np.testing.assert_array_equal(boxes[0], [[2, 1, 4, 2], [-1, -1, -1, -1], [5, 5, 5, 5]])
