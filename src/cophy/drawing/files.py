"""Short clips for people: animated GIFs, also as TensorBoard shows them (its own add_video needs an old moviepy).

Frames that people bring are read, pictures are written.
"""

import io
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import SummaryWriter

from cophy.atomic_files import write_atomically
from cophy.errors import CophyError
from cophy.scenario import Camera
from cophy.untrusted_files import BrokenFileError, open_clip, read_bytes

SUFFIXES, FORMATS = (".png", ".jpg", ".jpeg"), ("PNG", "JPEG")
MAX_FRAMES = 1000
MAX_EDGE = 4096  # pixels, as of render.resolution
MAX_BYTES = 2 << 30  # ours: of all frames together, many times what any sequence has


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) uint8 RGB picture as PNG, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].tobytes())


def read_frames(path: Path) -> np.ndarray:
    """(T, H, W, 3) RGB frames of a video, of one picture, or of a folder of pictures: 2.png comes before 10.png.

    Of many only the first MAX_FRAMES + 1 are read: the caller knows how many there have to be.

    Raises:
        CophyError: They are something else, not whole, of different sizes, or too large.
    """
    frames: list[np.ndarray] = []
    for frame in islice(_each(path), MAX_FRAMES + 1):
        frames.append(frame)
        if len(frames) * frame.nbytes > MAX_BYTES:
            raise CophyError(f"{path} holds more than {MAX_BYTES >> 20} MiB of pixels: give fewer pictures, or smaller")
    if not frames:
        raise CophyError(f"{path} holds no pictures: give a video, or a folder of .png or .jpg files")
    if len({frame.shape for frame in frames}) > 1:
        raise CophyError(f"{path}: its pictures are of different sizes")
    return np.stack(frames)


def _each(path: Path) -> Iterator[np.ndarray]:
    if path.is_dir():
        for file in sorted((file for file in path.iterdir() if file.suffix.lower() in SUFFIXES), key=_by_number):
            yield _read_picture(file)
    elif path.suffix.lower() in SUFFIXES:
        yield _read_picture(path)
    else:
        yield from _read_video(path)


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _read_picture(path: Path) -> np.ndarray:
    try:
        content = read_bytes(path.resolve())
        with Image.open(io.BytesIO(content), formats=FORMATS) as found:
            _check_size(path, *found.size)
            found.load()  # half a picture is refused here, but not by OpenCV
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    except CophyError:
        raise
    except Exception as error:  # whatever a hostile file makes Pillow and OpenCV raise
        why = " ".join(str(error).split()) or type(error).__name__
        raise CophyError(f"{path} is no picture that can be read whole: give .png or .jpg files ({why})") from error


def _read_video(path: Path) -> Iterator[np.ndarray]:
    try:
        video = open_clip(path.resolve())
    except (BrokenFileError, OSError, RuntimeError) as error:  # a link to itself is one of the last
        remedy = "give an MP4 file, or a folder of .png or .jpg files"
        raise CophyError(f"{path} is no video that can be read: {remedy} ({error})") from error
    try:
        _check_size(path, *(int(video.get(edge)) for edge in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)))
        while (read := video.read())[0]:
            yield cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB)
    finally:
        video.release()


def _check_size(path: Path, width: int, height: int) -> None:
    if max(width, height) > MAX_EDGE:
        raise CophyError(f"{path} has {width} × {height} pixels: give a picture of at most {MAX_EDGE} × {MAX_EDGE}")


def gif(frames: np.ndarray, *, frames_per_second: float) -> bytes:
    """(T, H, W, 3) uint8 -> an animated GIF that repeats."""
    pictures = [Image.fromarray(frame) for frame in frames]
    file = io.BytesIO()
    pictures[0].save(
        file, "GIF", save_all=True, append_images=pictures[1:], duration=round(1000 / frames_per_second), loop=0
    )
    return file.getvalue()


def add_clip(writer: SummaryWriter, name: str, frames: np.ndarray, *, frames_per_second: float, step: int) -> None:
    """Show a clip under TensorBoard's images.

    Args:
        writer: Of TensorBoard.
        name: Stands above it.
        frames: (T, H, W, 3) uint8.
        frames_per_second: How fast it plays.
        step: Of the training, where it is shown.
    """
    content = gif(frames, frames_per_second=frames_per_second)
    picture = Summary.Image(height=frames.shape[1], width=frames.shape[2], colorspace=3, encoded_image_string=content)
    writer._get_file_writer().add_summary(Summary(value=[Summary.Value(tag=name, image=picture)]), step)  # type: ignore[no-untyped-call]


def mark(frames: np.ndarray, positions: np.ndarray, presence: np.ndarray, *, camera: Camera, marker: int) -> np.ndarray:
    """A copy of frames with a marker where objects appear.

    Args:
        frames: (T, R, R, 3) uint8.
        positions: (T, K, 3) metres.
        presence: (T, K) which objects there are.
        camera: Sees them.
        marker: One of OpenCV's, such as `cv2.MARKER_CROSS`.
    """
    marked = frames.copy()
    pixels = np.rint(camera.project(positions, frames.shape[1])).astype(int)
    for frame, places, present in zip(marked, pixels, presence, strict=True):
        for x, y in places[present].tolist():
            for color, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
                cv2.drawMarker(frame, (x, y), color, marker, max(5, frames.shape[1] // 32), width)
    return marked
