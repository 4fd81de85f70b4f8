"""Frames that people bring are read, pictures are written."""

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from cophy.atomic_files import check_space
from cophy.errors import CophyError

SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_FRAMES = 1000


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) uint8 RGB picture as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
        check_space(path)
        raise CophyError(f"{path} cannot be written")


def read_frames(path: Path) -> np.ndarray:
    """(T, H, W, 3) RGB frames of a video, of one picture, or of a folder of pictures: 2.png comes before 10.png.

    Of a long video only the first MAX_FRAMES + 1 are read: the caller knows how many there have to be.
    """
    if path.is_dir():
        files = sorted((file for file in path.iterdir() if file.suffix.lower() in SUFFIXES), key=_by_number)
        frames = [_read_picture(file) for file in files]
    elif path.suffix.lower() in SUFFIXES:
        frames = [_read_picture(path)]
    else:
        frames = list(_read_video(path))
    if not frames:
        raise CophyError(f"{path} holds no pictures: give a video, or a folder of .png or .jpg files")
    if len({frame.shape for frame in frames}) > 1:
        raise CophyError(f"{path}: its pictures are of different sizes")
    return np.stack(frames)


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _read_picture(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise CophyError(f"{path} is no picture that OpenCV can read")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def _read_video(path: Path) -> Sequence[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    frames: list[np.ndarray] = []
    if not video.isOpened():
        raise CophyError(f"{path} is no video that OpenCV can read")
    while len(frames) <= MAX_FRAMES and (read := video.read())[0]:
        frames.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return frames
