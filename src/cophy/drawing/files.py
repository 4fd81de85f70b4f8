"""Frames from files, images and videos to files, and animated GIFs."""

import io
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageOps

from cophy.atomic_files import check_space, write_atomically
from cophy.errors import CophyError
from cophy.scenario import Camera
from cophy.untrusted_files import MAX_EDGE, BrokenFileError, check_size, open_clip, read_bytes

SUFFIXES, IMAGE_FORMATS = (".png", ".jpg", ".jpeg"), ("PNG", "JPEG")
# codec -> container: VP9 4:2:0 in WebM, which all browsers play, and MPEG-4, as the released clips; OpenCV's wheel has both
CONTAINERS = {"VP90": ".webm", "mp4v": ".mp4"}
MAX_FRAMES = 1000
MAX_RATE_ERROR = 0.01  # relative; ours: containers round
MAX_PIXEL_BYTES = 1 << 29  # ours: all frames together; 30 frames of 2440 × 2440
MAX_SCANS = 100  # ours: of a JPEG file; each costs as much as a picture, usual files have ten
_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")  # of JPEG; other bytes after 0xff are data


def write_image(path: Path, image: np.ndarray) -> None:
    """Write an (H, W, 3) uint8 RGB image as PNG, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())


def read_frames(path: Path, *, frame_rate_hz: float | None = None) -> np.ndarray:
    """Read RGB frames, (T, H, W, 3), of a video, of one image, or of a folder of images: 2.png comes before 10.png.

    At most MAX_FRAMES + 1 are read: the caller knows how many there must be.

    Args:
        path: the video, image or folder.
        frame_rate_hz: the rate that a video must have, if it states one.

    Raises:
        CophyError: a file is no image or video, incomplete, or too large, the sizes differ, or the rate is another.
    """
    frames: list[np.ndarray] = []
    for frame in islice(_read_each(path, frame_rate_hz), MAX_FRAMES + 1):
        frames.append(frame)
        if frame.shape != frames[0].shape:
            raise CophyError(f"{path}: its images have different sizes")
        if len(frames) * frame.nbytes > MAX_PIXEL_BYTES:
            raise CophyError(
                f"{path} holds more than {MAX_PIXEL_BYTES >> 20} MiB of pixels: give fewer or smaller images"
            )
    if not frames:
        raise CophyError(f"{path} holds no images: give a video, or a folder of .png or .jpg files")
    return np.stack(frames)


def _read_each(path: Path, frame_rate_hz: float | None) -> Iterator[np.ndarray]:
    if path.is_dir():
        for file in sorted((file for file in path.iterdir() if file.suffix.lower() in SUFFIXES), key=_numeric_key):
            yield _read_image(file)
    elif path.suffix.lower() in SUFFIXES:
        yield _read_image(path)
    else:
        yield from _read_video(path, frame_rate_hz)


def _numeric_key(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _read_image(path: Path) -> np.ndarray:
    try:
        content = read_bytes(path.resolve())
        with Image.open(io.BytesIO(content), formats=IMAGE_FORMATS) as image:
            check_size(path, *image.size)
            if image.format == "JPEG" and _count_scans(content) > MAX_SCANS:
                raise BrokenFileError(f"more than {MAX_SCANS} scans")
            if image.mode[0] in "IF":
                raise BrokenFileError("more than 8 bits per channel")
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except Exception as error:  # Pillow raises errors of many types on malformed files
        reason = " ".join(str(error).split()) or type(error).__name__
        remedy = f"give complete .png or .jpg files of at most {MAX_EDGE} × {MAX_EDGE} pixels"
        raise CophyError(f"{path} cannot be read: {remedy} ({reason})") from error


def _read_video(path: Path, frame_rate_hz: float | None) -> Iterator[np.ndarray]:
    try:
        video = open_clip(path.resolve())
    except (BrokenFileError, OSError, RuntimeError) as error:  # RuntimeError: a link to itself
        remedy = "give an MP4 file, or a folder of .png or .jpg files"
        raise CophyError(f"{path} is not a readable video: {remedy} ({error})") from error
    try:
        rate = video.get(cv2.CAP_PROP_FPS)
        if frame_rate_hz and rate > 0 and abs(rate - frame_rate_hz) > MAX_RATE_ERROR * frame_rate_hz:
            raise CophyError(
                f"{path} has {rate:g} frames per second, not {frame_rate_hz:g}: choose its frames at that rate"
            )
        while (frame := video.read()[1]) is not None:
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
    finally:
        video.release()


def write_video(path: Path, frames: np.ndarray, *, frame_rate_hz: int, codec: str) -> None:
    """Write RGB frames, (T, R, R, 3) uint8, with a codec of CONTAINERS; lossy.

    Raises:
        OSError: The file cannot be created, or the disk is full.
        CophyError: OpenCV did not write all frames, which it does not report.
    """
    file = path.with_name(f"{path.name}{CONTAINERS[codec]}")  # OpenCV derives the container from the suffix
    try:
        file.touch()  # OpenCV does not say why it cannot create a file
        writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*codec), frame_rate_hz, frames.shape[1:3])
        if not writer.isOpened():
            check_space(file)
            raise CophyError(f"{file}: this OpenCV has no encoder {codec}; install opencv-python-headless")
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()
        check_space(file)
        if (written := _count_frames(file)) != len(frames):
            raise CophyError(f"{file}: only {written} of {len(frames)} frames were written; is the disk full?")
        file.replace(path)
    finally:
        file.unlink(missing_ok=True)


def _count_frames(path: Path) -> int:
    """Count the frames of a clip by decoding it."""
    video, count = cv2.VideoCapture(str(path)), 0
    while video.grab():
        count += 1
    return count


def _count_scans(jpeg: bytes) -> int:
    """Return the number of scans of an image: a few bytes can repeat the work of decoding all pixels."""
    count, position = 0, 2
    while (marker := _MARKER.search(jpeg, position)) and marker[1] != b"\xd9":  # end of image
        count += marker[1] == b"\xda"  # start of scan
        position = marker.end() + int.from_bytes(jpeg[marker.end() : marker.end() + 2], "big")
    return count


def encode_gif(frames: np.ndarray, *, frames_per_second: float) -> bytes:
    """Encode frames (T, H, W, 3) uint8 as an animated GIF that repeats."""
    images = [Image.fromarray(frame) for frame in frames]
    file = io.BytesIO()
    images[0].save(
        file, "GIF", save_all=True, append_images=images[1:], duration=round(1000 / frames_per_second), loop=0
    )
    return file.getvalue()


def mark(frames: np.ndarray, positions: np.ndarray, presence: np.ndarray, *, camera: Camera, marker: int) -> np.ndarray:
    """Return a copy of frames with a marker at the projected position of each object.

    Args:
        frames: (T, R, R, 3) uint8.
        positions: (T, K, 3) metres.
        presence: (T, K) which slots hold an object.
        marker: marker type of OpenCV, such as `cv2.MARKER_CROSS`.
    """
    marked = frames.copy()
    pixels = np.rint(camera.project(positions, frames.shape[1])).astype(int)
    for frame, centres, present in zip(marked, pixels, presence, strict=True):
        for x, y in centres[present].tolist():
            for color, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
                cv2.drawMarker(frame, (x, y), color, marker, max(5, frames.shape[1] // 32), width)
    return marked
