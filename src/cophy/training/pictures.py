"""Pictures for people: sequences side by side, frame strips, contact sheets; and reading frames that people bring."""

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Frames, Renderer

GAP_PX = 4
SUFFIXES = (".png", ".jpg", ".jpeg")
MOST_FRAMES = 1000


def render_sequence(
    renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int, sequence: int, times: slice | Sequence[int]
) -> Frames:
    """Draw frames of AB (sequence 0) or CD (1) of an experiment of a loaded dataset."""
    states = arrays["states"][experiment, sequence, :: renderer.scenario.clock.states_per_frame][times]
    return renderer.render(
        states[..., :3],
        states[..., 3:7],
        presence=arrays["presence"][experiment, sequence],
        shapes=arrays["shape"][experiment].tolist(),
        background_seed=int(arrays["background_seed"][experiment]),
    )


def grid(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Pictures of one size, (H, W, 3) uint8, in rows and columns with white gaps."""

    def join(parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
        gap = np.full((GAP_PX, parts[0].shape[1], 3) if axis == 0 else (parts[0].shape[0], GAP_PX, 3), 255, np.uint8)
        return np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=axis)

    return join([join(row, axis=1) for row in rows], axis=0)


def titled(frames: np.ndarray, title: str) -> np.ndarray:
    """(T, H, W, 3) frames with a line of text above."""
    size = frames.shape[2]
    bar = np.full((max(18, size // 14), size, 3), 255, np.uint8)
    scale = bar.shape[0] / 36
    cv2.putText(bar, title, (4, int(0.72 * bar.shape[0])), cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([np.broadcast_to(bar, (len(frames), *bar.shape)), frames], axis=1)


def side_by_side(sequences: dict[str, np.ndarray]) -> np.ndarray:
    """Sequences (T, R, R, 3) next to each other, each under its title."""
    parts = [titled(frames, title) for title, frames in sequences.items()]
    return np.stack([grid([row]) for row in zip(*parts, strict=True)])


def segmentation_in_color(segmentation: np.ndarray, scenario: Scenario) -> np.ndarray:
    """(..., R, R) slots -> (..., R, R, 3) in the slots' colours, white where there is no object."""
    palette = np.full((256, 3), 255, np.uint8)
    palette[: scenario.num_slots] = [[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in scenario.colors.values()]
    return palette[segmentation]


def depth_in_grey(depth: np.ndarray) -> np.ndarray:
    """(..., R, R) millimetres -> (..., R, R, 3): near is bright, nothing is black."""
    seen = depth > 0
    near, far = (float(depth[seen].min()), float(depth[seen].max())) if seen.any() else (0.0, 1.0)
    grey = np.where(seen, 60 + 195 * (far - depth.astype(float)) / max(far - near, 1.0), 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """An (H, W, 3) RGB picture as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
        raise CophyError(f"{path} cannot be written")


def read_frames(path: Path) -> np.ndarray:
    """(T, H, W, 3) RGB frames of a video, of one picture, or of a folder of pictures: 2.png comes before 10.png.

    Of a long video only the first MOST_FRAMES + 1 are read: who calls knows how many there have to be.
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
    while len(frames) <= MOST_FRAMES and (read := video.read())[0]:
        frames.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return frames
