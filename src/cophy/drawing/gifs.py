"""Short clips for people: animated GIFs, also as TensorBoard shows them (its own add_video needs an old moviepy)."""

import io

import cv2
import numpy as np
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import SummaryWriter

from cophy.scenario import Camera


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
