"""Frames that people bring."""

from pathlib import Path

import numpy as np
import pytest

from cophy.drawing.picture_files import read_frames, write_picture
from cophy.errors import CophyError


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
