"""Frames that people bring."""

import errno
import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from cophy.drawing import files
from cophy.drawing.files import read_frames, write_picture
from cophy.errors import CophyError
from tests.released.trees import clip


def test_frames_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in range(12):
        write_picture(tmp_path / f"frame_{number}.png", np.full((4, 4, 3), 10 * number, np.uint8))
    frames = read_frames(tmp_path)
    assert frames[:, 0, 0, 0].tolist() == [10 * number for number in range(12)]
    assert read_frames(tmp_path / "frame_3.png").shape == (1, 4, 4, 3)


def test_what_is_no_picture_is_named(tmp_path: Path) -> None:
    for name, match in (("empty", "holds no pictures"), ("missing.mp4", "is no video")):
        if name == "empty":
            (tmp_path / name).mkdir()
        with pytest.raises(CophyError, match=match):
            read_frames(tmp_path / name)
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    with pytest.raises(CophyError, match=r"bad\.png is no picture"):
        read_frames(tmp_path / "bad.png")
    write_picture(tmp_path / "mixed" / "0.png", np.zeros((4, 4, 3), np.uint8))
    write_picture(tmp_path / "mixed" / "1.png", np.zeros((5, 5, 3), np.uint8))
    with pytest.raises(CophyError, match="different sizes"):
        read_frames(tmp_path / "mixed")


def png_of(width: int, height: int) -> bytes:
    """A PNG that says it is so large, and holds a few bytes."""
    head = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 2, 0, 0, 0])
    data = b"IDAT" + zlib.compress(bytes(100))
    chunks = [(len(each) - 4).to_bytes(4, "big") + each + zlib.crc32(each).to_bytes(4, "big") for each in (head, data)]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize(
    ("width", "message"), [(100_000, "is no picture that can be read whole"), (5000, "has 5000 × 5000 pixels: give a")]
)
def test_a_picture_that_says_it_is_large_takes_no_memory(tmp_path: Path, width: int, message: str) -> None:
    (tmp_path / "large.png").write_bytes(png_of(width, width))
    with pytest.raises(CophyError, match=rf"large\.png {message}"):
        read_frames(tmp_path)


def test_half_a_picture_is_refused(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    for suffix in (".jpg", ".png"):
        path, content = tmp_path / f"half{suffix}", cv2.imencode(suffix, picture)[1].tobytes()
        path.write_bytes(content)
        assert read_frames(path).shape == (1, 64, 64, 3)
        path.write_bytes(content[: len(content) // 2])
        with pytest.raises(CophyError, match=rf"half\{suffix} is no picture that can be read whole"):
            read_frames(path)


@pytest.mark.parametrize("name", ["pipe.png", "pipe.mp4"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(CophyError, match=r"pipe\.\w+ is no (picture|video) that can be read"):
        read_frames(tmp_path / name)


def test_a_video_is_read_and_what_only_bears_its_name_is_not_followed(tmp_path: Path) -> None:
    clip(tmp_path / "secret.mp4", 3, 5, 32)
    (tmp_path / "linked.mp4").symlink_to(tmp_path / "secret.mp4")
    for name in ("secret.mp4", "linked.mp4"):
        assert read_frames(tmp_path / name).shape == (3, 32, 32, 3)
    (tmp_path / "AB.mp4").write_text("ffconcat version 1.0\nfile secret.mp4\n")
    with pytest.raises(CophyError, match=r"AB\.mp4 is no video that can be read: give an MP4 file, or a folder"):
        read_frames(tmp_path / "AB.mp4")


def test_frames_that_are_too_many_together_are_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip(tmp_path / "AB.mp4", 5, 5, 512)
    monkeypatch.setattr(files, "MAX_BYTES", 3 << 20)
    with pytest.raises(CophyError, match=r"AB\.mp4 holds more than 3 MiB of pixels"):
        read_frames(tmp_path / "AB.mp4")


def test_a_picture_that_cannot_be_written_leaves_the_older_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "strip.png"
    write_picture(path, np.zeros((4, 4, 3), np.uint8))
    before = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_picture(path, np.ones((4, 4, 3), np.uint8))
    assert caught.value.filename == str(path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [before]
    monkeypatch.undo()
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OSError, match="Is a directory") as caught:
        write_picture(tmp_path / "folder.png", np.ones((4, 4, 3), np.uint8))
    assert caught.value.filename == str(tmp_path / "folder.png")
