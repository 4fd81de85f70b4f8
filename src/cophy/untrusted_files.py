"""Files of unknown origin: read whole or refused, never followed, executed or allocated for on their word."""

import io
import math
import os
import stat
from pathlib import Path

import cv2
import numpy as np

MAX_BYTES = 64 << 20  # ours: the largest file of either format that is read whole is below 1 MiB
MP4_BRAND = b"ftyp"  # bytes 4 to 7 of every MP4 file


class BrokenFileError(Exception):
    """A file is not what its format says; the message names it."""


def read_bytes(path: Path) -> bytes:
    """All bytes of a regular file; links, devices, pipes and files beyond MAX_BYTES are refused."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(descriptor, "rb") as file:
            about = os.fstat(descriptor)
            if not stat.S_ISREG(about.st_mode):
                raise BrokenFileError(f"{path} is not a regular file")
            if about.st_size > MAX_BYTES:
                raise BrokenFileError(f"{path} has {about.st_size} bytes, more than any file of its kind")
            return file.read()
    except OSError as error:
        what = "is a link" if path.is_symlink() else f"cannot be read ({error.strerror})"
        raise BrokenFileError(f"{path} {what}") from error


def read_text(path: Path) -> str:
    """The text of a small file."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise BrokenFileError(f"{path} is not text") from error


def read_array(path: Path) -> np.ndarray:
    """A .npy file of plain numbers as float64; its header must agree with its size before anything is made of it."""
    content = read_bytes(path)
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, fortran_order, dtype = header(file)
    except Exception as error:  # whatever a hostile header makes NumPy raise
        raise BrokenFileError(f"{path} is not a .npy file ({' '.join(str(error).split())})") from error
    if dtype.kind not in "fiu":
        raise BrokenFileError(f"{path} holds {dtype}, not plain numbers: pickled objects are not read")
    counts = all(type(length) is int and length >= 0 for length in shape)
    if len(shape) > 3 or not counts or math.prod(shape) * dtype.itemsize != len(content) - file.tell():
        raise BrokenFileError(f"{path} says {dtype} {shape} and holds {len(content) - file.tell()} bytes")
    flat = np.frombuffer(content, dtype, offset=file.tell())
    array = flat.reshape(shape, order="F" if fortran_order else "C").astype(np.float64)
    if not np.isfinite(array).all():
        raise BrokenFileError(f"{path} holds numbers that are not finite")
    return array


def count_frames(path: Path) -> int:
    """Frames of a clip as its container counts them; 0 where there is no clip."""
    if not os.path.lexists(path):
        return 0
    capture = open_clip(path)
    try:
        return int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()


def open_clip(path: Path) -> cv2.VideoCapture:
    """An MP4 file to decode; what only bears its name is refused, for a decoder would guess and follow references."""
    if path.is_symlink() or not path.is_file():
        raise BrokenFileError(f"{path} is not a regular file")
    with open(path, "rb") as file:
        start = file.read(8)
    if start[4:] != MP4_BRAND:
        raise BrokenFileError(f"{path} is not an MP4 file")
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise BrokenFileError(f"{path} cannot be decoded")
    return capture
