"""Frames from files, and images to files."""

import errno
import os
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from cophy.drawing import files
from cophy.drawing.files import read_frames, write_image
from cophy.errors import CophyError
from tests.conftest import raising
from tests.released.trees import clip


def test_frames_are_in_numerical_order(tmp_path: Path) -> None:
    for number in range(12):
        write_image(tmp_path / f"frame_{number}.png", np.full((4, 4, 3), 10 * number, np.uint8))
    frames = read_frames(tmp_path)
    assert frames[:, 0, 0, 0].tolist() == [10 * number for number in range(12)]
    assert read_frames(tmp_path / "frame_3.png").shape == (1, 4, 4, 3)


def test_files_that_are_not_images_are_named(tmp_path: Path) -> None:
    for name, match in (("empty", "holds no images"), ("missing.mp4", "is not a readable video")):
        if name == "empty":
            (tmp_path / name).mkdir()
        with pytest.raises(CophyError, match=match):
            read_frames(tmp_path / name)
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    with pytest.raises(CophyError, match=r"bad\.png cannot be read"):
        read_frames(tmp_path / "bad.png")
    write_image(tmp_path / "mixed" / "0.png", np.zeros((4, 4, 3), np.uint8))
    write_image(tmp_path / "mixed" / "1.png", np.zeros((5, 5, 3), np.uint8))
    with pytest.raises(CophyError, match="different sizes"):
        read_frames(tmp_path / "mixed")


def png_of(width: int, height: int, zeros: int = 100) -> bytes:
    """A PNG of this size by its header, with some zeros as data."""
    head = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 2, 0, 0, 0])
    data = b"IDAT" + zlib.compress(bytes(zeros), level=1)
    chunks = [(len(each) - 4).to_bytes(4, "big") + each + zlib.crc32(each).to_bytes(4, "big") for each in (head, data)]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("width", [100_000, 5000])
def test_a_header_with_a_huge_size_takes_no_memory(tmp_path: Path, width: int) -> None:
    (tmp_path / "large.png").write_bytes(png_of(width, width))
    with pytest.raises(CophyError, match=r"large\.png cannot be read: .* at most 4096 × 4096 pixels"):
        read_frames(tmp_path)


def test_data_after_the_last_pixel_are_not_unpacked(tmp_path: Path) -> None:
    (tmp_path / "long.png").write_bytes(png_of(64, 64, zeros=1 << 29))
    start = time.process_time()
    assert read_frames(tmp_path).shape == (1, 64, 64, 3)
    assert time.process_time() - start < 0.5


def test_a_jpeg_file_that_repeats_its_scans_is_refused(tmp_path: Path) -> None:
    Image.new("RGB", (64, 64)).save(tmp_path / "scans.jpg", progressive=True)
    content = (tmp_path / "scans.jpg").read_bytes()
    assert read_frames(tmp_path).shape == (1, 64, 64, 3)
    scan = content[content.rindex(b"\xff\xda") : -2]
    (tmp_path / "scans.jpg").write_bytes(content[:-2] + scan * 200 + content[-2:])
    with pytest.raises(CophyError, match=r"scans\.jpg cannot be read: .*more than 100 scans"):
        read_frames(tmp_path)


def test_images_of_16_bits_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "deep.png"), np.full((8, 8), 40_000, np.uint16))
    with pytest.raises(CophyError, match=r"deep\.png cannot be read: .*8 bits"):
        read_frames(tmp_path)


def test_a_huge_clip_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    clip(tmp_path / "huge.mp4", 1, 5, 4112)
    with pytest.raises(CophyError, match=r"huge\.mp4 has 4112 × 4112 pixels"):
        read_frames(tmp_path / "huge.mp4")


def test_a_truncated_image_is_refused(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    for suffix in (".jpg", ".png"):
        path, content = tmp_path / f"half{suffix}", cv2.imencode(suffix, picture)[1].tobytes()
        path.write_bytes(content)
        assert read_frames(path).shape == (1, 64, 64, 3)
        path.write_bytes(content[: len(content) // 2])
        with pytest.raises(CophyError, match=rf"half\{suffix} cannot be read"):
            read_frames(path)


@pytest.mark.parametrize("name", ["pipe.png", "pipe.mp4"])
def test_a_pipe_does_not_block(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(CophyError, match=r"pipe\.\w+ (cannot be read|is not a readable video)"):
        read_frames(tmp_path / name)


def test_a_video_is_read_and_a_playlist_named_like_one_is_not(tmp_path: Path) -> None:
    clip(tmp_path / "secret.mp4", 3, 5, 32)
    (tmp_path / "linked.mp4").symlink_to(tmp_path / "secret.mp4")
    for name in ("secret.mp4", "linked.mp4"):
        assert read_frames(tmp_path / name).shape == (3, 32, 32, 3)
    (tmp_path / "AB.mp4").write_text("ffconcat version 1.0\nfile secret.mp4\n")
    with pytest.raises(CophyError, match=r"AB\.mp4 is not a readable video: give an MP4 file, or a folder"):
        read_frames(tmp_path / "AB.mp4")


def test_the_name_of_a_video_is_not_read_as_a_pattern(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"f{number}.bmp"), np.zeros((32, 32, 3), np.uint8))
    (tmp_path / "f%d.bmp").write_bytes(b"\0\0\0\x18ftypisom" + bytes(64))
    with pytest.raises(CophyError, match=r"f%d\.bmp is not a readable video"):
        read_frames(tmp_path / "f%d.bmp")


def test_a_video_of_another_rate_is_refused(tmp_path: Path) -> None:
    for rate in (5, 25):
        clip(tmp_path / f"{rate}.mp4", 3, rate, 32)
    assert read_frames(tmp_path / "5.mp4", frame_rate_hz=5).shape == (3, 32, 32, 3)
    with pytest.raises(CophyError, match=r"25\.mp4 has 25 frames per second, not 5: choose its frames at that rate"):
        read_frames(tmp_path / "25.mp4", frame_rate_hz=5)


def test_too_many_pixels_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip(tmp_path / "AB.mp4", 5, 5, 512)
    monkeypatch.setattr(files, "MAX_PIXEL_BYTES", 3 << 20)
    with pytest.raises(CophyError, match=r"AB\.mp4 holds more than 3 MiB of pixels"):
        read_frames(tmp_path / "AB.mp4")


def test_a_failed_write_keeps_the_older_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "strip.png"
    write_image(path, np.zeros((4, 4, 3), np.uint8))
    before = path.read_bytes()

    monkeypatch.setattr(os, "fsync", raising(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left") as caught:
        write_image(path, np.ones((4, 4, 3), np.uint8))
    assert caught.value.filename == str(path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [before]
    monkeypatch.undo()
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OSError, match="Is a directory") as caught:
        write_image(tmp_path / "folder.png", np.ones((4, 4, 3), np.uint8))
    assert caught.value.filename == str(tmp_path / "folder.png")
