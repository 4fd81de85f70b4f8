"""Frames in rows and columns, titled; depth and segmentation as colours."""

from collections.abc import Sequence

import cv2
import numpy as np
from PIL import ImageColor

from cophy.scenario import Scenario

GAP_PX = 4
MIN_TITLE_PX = 18
TITLE_LINES = 14  # one line of text is this share of the picture's width
WHITE = 255


def grid(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Pictures of one size, (H, W, 3) uint8, in rows and columns with white gaps."""

    def join(parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
        gap = np.full((GAP_PX, parts[0].shape[1], 3) if axis == 0 else (parts[0].shape[0], GAP_PX, 3), WHITE, np.uint8)
        return np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=axis)

    return join([join(row, axis=1) for row in rows], axis=0)


def titled(frames: np.ndarray, title: str) -> np.ndarray:
    """(T, H, W, 3) frames with a line of text above."""
    size = frames.shape[2]
    bar = np.full((max(MIN_TITLE_PX, size // TITLE_LINES), size, 3), WHITE, np.uint8)
    scale = bar.shape[0] / 36
    cv2.putText(bar, title, (4, int(0.72 * bar.shape[0])), cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([np.broadcast_to(bar, (len(frames), *bar.shape)), frames], axis=1)


def side_by_side(sequences: dict[str, np.ndarray]) -> np.ndarray:
    """Sequences (T, R, R, 3) next to each other, each under its title."""
    parts = [titled(frames, title) for title, frames in sequences.items()]
    return np.stack([grid([row]) for row in zip(*parts, strict=True)])


def segmentation_in_color(segmentation: np.ndarray, scenario: Scenario) -> np.ndarray:
    """(..., R, R) slots -> (..., R, R, 3) in the slots' colours, white where there is no object."""
    palette = np.full((256, 3), WHITE, np.uint8)
    palette[: scenario.num_slots] = [ImageColor.getrgb(color) for color in scenario.colors.values()]
    return palette[segmentation]


def depth_in_grey(depth: np.ndarray) -> np.ndarray:
    """(..., R, R) millimetres -> (..., R, R, 3): near is bright, nothing is black."""
    seen = depth > 0
    near, far = (float(depth[seen].min()), float(depth[seen].max())) if seen.any() else (0.0, 1.0)
    grey = np.where(seen, 60 + 195 * (far - depth.astype(float)) / max(far - near, 1.0), 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
