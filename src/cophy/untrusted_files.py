"""Readers of files from elsewhere: they follow no links, execute nothing, and bound memory by the size of the file."""

import io
import os
import stat
from pathlib import Path

import cv2
import numpy as np

MAX_FILE_BYTES = 64 << 20  # ours: the largest file of either format that is read whole is below 1 MiB
MAX_EDGE = 4096  # pixels of an image, the limit of render.resolution
MP4_BRAND = b"ftyp"  # bytes 4 to 7 of every MP4 file


class BrokenFileError(Exception):
    """A file is not what its format says, or contradicts others; the message says which and how."""


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a regular file; links, devices, pipes and files beyond MAX_FILE_BYTES are refused."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise BrokenFileError(f"{path} is not a regular file")
            if status.st_size > MAX_FILE_BYTES:
                raise BrokenFileError(f"{path} has {status.st_size} bytes, more than any file of its kind")
            return file.read()
    except OSError as error:
        what = "is a link" if path.is_symlink() else f"cannot be read ({error.strerror})"
        raise BrokenFileError(f"{path} {what}") from error


def read_text(path: Path) -> str:
    """Return the text of a small file."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise BrokenFileError(f"{path} is not text") from error


def read_array(path: Path) -> np.ndarray:
    """Return the numbers of a .npy file as float64; pickled objects are refused."""
    content = io.BytesIO(read_bytes(path))
    try:
        array = np.lib.format.read_array(content, allow_pickle=False)  # touches no more memory than the file has bytes
    except Exception as error:  # NumPy raises errors of many types on malformed headers
        raise BrokenFileError(f"{path} is not a .npy file of numbers ({' '.join(str(error).split())})") from error
    if array.dtype.kind not in "fiu":
        raise BrokenFileError(f"{path} holds {array.dtype}, not numbers")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise BrokenFileError(f"{path} holds numbers that are not finite")
    return array


def count_frames(path: Path) -> int:
    """Return the number of frames of a clip by its container; 0 where there is no clip."""
    if not os.path.lexists(path):
        return 0
    capture = open_clip(path)
    try:
        return int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()


def open_clip(path: Path) -> cv2.VideoCapture:
    """Open an MP4 file of at most MAX_EDGE × MAX_EDGE pixels.

    Other content is refused, because the decoder would guess the format and follow references.
    """
    if path.is_symlink() or not path.is_file():
        raise BrokenFileError(f"{path} is not a regular file")
    with open(path, "rb") as file:
        if file.read(8)[4:] != MP4_BRAND:
            raise BrokenFileError(f"{path} is not an MP4 file")
        # not by name: FFmpeg reads f%d.bmp as a pattern of names
        capture = cv2.VideoCapture(f"/dev/fd/{file.fileno()}", cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise BrokenFileError(f"{path} cannot be decoded")
    check_size(path, *(int(capture.get(edge)) for edge in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)))
    return capture


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse an image or a clip by its size, before it is decoded."""
    if max(width, height) > MAX_EDGE:
        raise BrokenFileError(f"{path} has {width} × {height} pixels, more than {MAX_EDGE} × {MAX_EDGE}")
