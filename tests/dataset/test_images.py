"""Images on disk: lossless, resumable, of the states next to them, and no more than needed."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.experiment_set import ALL_FRAMES, INPUTS, TEST_INPUTS, NeededFrames
from cophy.dataset.images import Images, bounding_boxes
from cophy.errors import CophyError
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Backend, Frames, Renderer
from tests.dataset.copies import IMAGE_SPEC, RENDER, copy_images, digests, empty, images
from tests.dataset.test_experiment_set import SINGLE, TEST


def test_what_is_stored_is_what_was_drawn(rendered: Images) -> None:
    arrays = rendered.states.load()
    with Renderer(IMAGE_SPEC.scenario, RENDER.resolution) as renderer, h5py.File(rendered.path(1), "r") as file:
        for experiment, sequence in ((6, 0), (9, 1)):
            states = arrays["states"][experiment, sequence, :: IMAGE_SPEC.scenario.clock.states_per_frame]
            drawn = renderer.render(
                states[..., :3],
                states[..., 3:7],
                presence=arrays["presence"][experiment, sequence],
                shapes=arrays["shape"][experiment].tolist(),
                background_seed=int(arrays["background_seed"][experiment]),
            )
            for name in MODALITIES:
                np.testing.assert_array_equal(file[name][experiment - 6, sequence], getattr(drawn, name))


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
        copied.report_damage(0),
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
    assert "shard-00000.h5 is damaged (it belongs to other data: its states_sha256" in caplog.text


def test_rgb_that_another_set_holds_is_not_rendered_again(rendered: Images, tmp_path: Path) -> None:
    """And has the bytes that a rendering of its own has."""
    copied = copy_images(rendered, tmp_path)
    rgb = copied.states.frames(replace(RENDER, modalities=["rgb"]))
    rgb.ensure(workers=1)
    assert not rgb.directory.exists()
    arrays = copied.states.load()
    read, pictures = rgb.reader(arrays), rgb.pictures(arrays, ["rgb"])
    clips = {(row, sequence): clip for row, sequence, _, clip in rgb.sequences(1)}
    found = {(row, sequence): pictures(6 + row)["rgb"][sequence] for row, sequence in clips}
    frame = read(9, 1, 7)

    generation.make(rgb, workers=2)
    assert rgb.best_available() is rgb
    with h5py.File(rgb.path(1), "r") as file:
        assert set(file) == {"rgb", "boxes"}
        np.testing.assert_array_equal(frame, file["rgb"][3, 1, 7])
        for (row, sequence), clip in clips.items():
            np.testing.assert_array_equal(clip, file["rgb"][row, sequence])
            np.testing.assert_array_equal(found[row, sequence], clip)


def test_images_of_another_size_or_renderer_are_no_substitute(rendered: Images) -> None:
    for changes in ({"resolution": 20}, {"backend": Backend.egl}):
        other = rendered.states.frames(replace(RENDER, modalities=["rgb"], **changes))
        assert other.best_available() is other


def test_a_set_with_fewer_modalities_is_no_substitute(rendered: Images, tmp_path: Path) -> None:
    few = images(tmp_path).states.frames(replace(RENDER, modalities=["rgb", "depth"]))
    copied = copy_images(rendered, tmp_path)
    assert few.best_available().directory == copied.directory
    copied.directory.joinpath("manifest.json").unlink()
    assert few.best_available() is few


def test_boxes_enclose_what_is_seen_of_each_object() -> None:
    segmentation = np.full((1, 6, 6), NO_OBJECT, dtype=np.uint8)
    segmentation[0, 1:3, 2:5] = 0
    segmentation[0, 5, 5] = 2
    boxes = bounding_boxes(Frames(np.zeros(0), np.zeros(0), segmentation), 3)
    np.testing.assert_array_equal(boxes[0], [[2, 1, 4, 2], [-1, -1, -1, -1], [5, 5, 5, 5]])


def only(finished: Images, data_dir: Path, needed: NeededFrames) -> Images:
    """The same pictures, of some frames, of the same states; not drawn yet."""
    copied = copy_images(finished, data_dir)
    empty(copied.directory)
    return copied.states.frames(RENDER, needed)


@pytest.mark.parametrize("needed", [INPUTS, TEST_INPUTS, SINGLE], ids=lambda needed: needed.name)
def test_some_frames_are_drawn_as_all_are(rendered: Images, tmp_path: Path, needed: NeededFrames) -> None:
    few = only(rendered, tmp_path, needed)
    generation.make(few, workers=2)
    arrays = few.states.load()
    drawn = needed.mask(arrays["split"], 0, 15)
    read = few.load()
    assert few.directory.name.startswith(rendered.directory.name)
    np.testing.assert_array_equal(read["drawn"], drawn)
    for name, everything in rendered.load().items():
        np.testing.assert_array_equal(read[name][drawn], everything[drawn])
        assert (read[name][~drawn] == (-1 if name == "boxes" else 0)).all()
    if needed is not SINGLE:
        return
    assert sum(few.path(shard).stat().st_size for shard in (0, 1)) < 0.5 * sum(
        rendered.path(shard).stat().st_size for shard in (0, 1)
    )


def test_a_frame_that_was_not_drawn_is_not_read(rendered: Images, tmp_path: Path) -> None:
    few = only(rendered, tmp_path, SINGLE)
    generation.make(few, workers=1)
    read = few.reader(few.states.load())
    with h5py.File(rendered.path(1)) as file:
        np.testing.assert_array_equal(read(7, 1, 7), file["rgb"][1, 1, 7])
    with pytest.raises(ValueError, match="frame 9 of sequence 1 was not requested"):
        read(7, 1, 9)


def test_frames_that_a_wider_set_holds_are_not_drawn_again(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    few = copied.states.frames(RENDER, TEST_INPUTS)
    few.ensure(workers=1)
    assert not few.directory.exists()
    assert few.best_available().directory == copied.directory
    arrays = copied.states.load()
    tested = set(np.flatnonzero(arrays["split"][6:] == TEST).tolist())
    seen = {(row, sequence): times.tolist() for row, sequence, times, _ in few.sequences(1)}
    assert seen == {(row, sequence): [[*range(15)], [0]][sequence] for row in tested for sequence in (0, 1)}


def test_a_narrower_set_is_no_substitute(rendered: Images, tmp_path: Path) -> None:
    few = only(rendered, tmp_path, TEST_INPUTS)
    generation.make(few, workers=1)
    for needed in (INPUTS, ALL_FRAMES, SINGLE):
        wanted = few.states.frames(RENDER, needed)
        assert wanted.best_available() is not few
        assert not wanted.best_available().is_finished()
