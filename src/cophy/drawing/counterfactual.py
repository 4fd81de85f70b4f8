"""What predict.py writes: predicted positions as a table, a clip and a strip of AB, the truth and the prediction."""

from pathlib import Path

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.drawing.files import encode_gif, write_image
from cophy.drawing.overview import SHAPE_NAMES, strip_times
from cophy.drawing.sheets import Line, Row, at, cell_px, labelled_rows, side_by_side, with_caption
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.camera import Window
from cophy.scenario.rendering import NO_OBJECT, Renderer

PREDICTED = "CD: predicted"
IDENTITY_XYZW = (0.0, 0.0, 0.0, 1.0)
UNKNOWN_BACKGROUND = 225  # brightness where the background is not known
MIN_CHANGE = 24  # a pixel this much brighter or darker than the background shows an object or its shadow
WINDOW_MARGIN = 0.04  # around the changed pixels, as a share of the image


def render_positions(
    positions: np.ndarray, presence: np.ndarray, scenario: Scenario, background: np.ndarray
) -> np.ndarray:
    """Render positions without known shapes and rotations: shapes are the scenario's default, and nothing is rotated.

    Args:
        positions: (T, K, 3) metres.
        presence: (K,) which slots hold an object.
        background: (R, R, 3) uint8, the scene without objects. Objects and their shadows are drawn over it.

    Returns:
        (T, R, R, 3) uint8.
    """
    upright = np.broadcast_to(IDENTITY_XYZW, (*positions.shape[:2], 4))
    shapes = [int(scenario.shape_from_positions)] * scenario.num_slots
    absent = np.zeros_like(presence)
    with Renderer(scenario, len(background)) as renderer:
        empty = renderer.render(positions[:1], upright[:1], presence=absent, shapes=shapes, background_seed=0).rgb
        frames = renderer.render(positions, upright, presence=presence, shapes=shapes, background_seed=0)
    brightness = np.minimum(frames.rgb / np.maximum(empty, 1.0), 1.0)  # less than 1 in shadows
    shaded = np.rint(background * brightness).astype(np.uint8)
    return np.where(frames.segmentation[..., None] == NO_OBJECT, shaded, frames.rgb)


def write_counterfactual(
    directory: Path,
    positions: np.ndarray,
    presence: np.ndarray,
    scenario: Scenario,
    *,
    observed: np.ndarray,
    truth: np.ndarray | None,
    background: np.ndarray | None,
) -> None:
    """Write positions.csv, prediction.gif and strip.png.

    Args:
        positions: (T, K, 3) metres, C and then the predicted D.
        presence: (K,) which slots hold an object.
        observed: (T, R, R, 3) uint8 frames of AB.
        truth: frames of the true CD, where known.
        background: (R, R, 3) uint8, the scene without objects, where known. Images are cropped to what differs from it.

    Raises:
        CophyError: number or size of the true frames, or the size of the background, differ from AB.
    """
    if truth is not None and truth.shape != observed.shape:
        raise CophyError(f"truth has {truth.shape[:3]} frames, rows and columns, AB has {observed.shape[:3]}")
    if background is not None and background.shape != observed.shape[1:]:
        raise CophyError(f"background has {background.shape[:2]} rows and columns, AB has {observed.shape[1:3]}")
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / "positions.csv", _to_csv(positions, presence, scenario).encode())
    canvas = np.full_like(observed[0], UNKNOWN_BACKGROUND) if background is None else background
    sequences = {"AB: observed": observed} | ({} if truth is None else {"CD: true outcome": truth})
    sequences[PREDICTED] = render_positions(positions, presence, scenario, canvas)
    if background is not None:
        window = window_of_changes(np.concatenate(list(sequences.values())), background)
        sequences = {name: window.cut(frames) for name, frames in sequences.items()}
    rate, times = scenario.clock.frame_rate_hz, strip_times(scenario)
    clip = side_by_side(sequences, frame_rate_hz=rate)
    write_atomically(directory / "prediction.gif", encode_gif(clip, frames_per_second=rate))
    rows: list[Row] = [
        (_label(name, scenario, background is not None), frames[times]) for name, frames in sequences.items()
    ]
    strip = labelled_rows([at(time, rate) for time in times], rows, cell_px(observed.shape[1]))
    title = Line(f"{scenario.name}: what would have happened if the start had been C?", bold=True)
    write_image(directory / "strip.png", with_caption([title], strip))


def window_of_changes(frames: np.ndarray, background: np.ndarray) -> Window:
    """Return the smallest square, with a margin, in which frames (T, R, R, 3) differ from the background (R, R, 3)."""
    size = len(background)
    changed = (np.abs(frames.astype(np.int16) - background).max(axis=-1) > MIN_CHANGE).any(axis=0)
    if not changed.any():
        return Window(0.0, 0.0, 1.0)
    pixels = np.argwhere(changed)[:, ::-1] / size
    low, high = pixels.min(axis=0) - WINDOW_MARGIN, pixels.max(axis=0) + 1 / size + WINDOW_MARGIN
    edge = min(1.0, float((high - low).max()))
    left, top = np.clip((low + high - edge) / 2, 0, 1 - edge).tolist()
    return Window(left, top, edge)


def _label(name: str, scenario: Scenario, background_is_known: bool) -> list[Line]:
    """Return the text next to a sequence."""
    lines = [Line(name, bold=True)]
    if name == PREDICTED:
        shape = SHAPE_NAMES[scenario.shape_from_positions]
        lines.append(Line("From the images of AB and C alone."))
        lines.append(Line(f"Only positions are predicted: every object is drawn as a {shape}, not rotated."))
        lines += [] if background_is_known else [Line("Grey: the background is not known (background=).")]
    return lines


def _to_csv(positions: np.ndarray, presence: np.ndarray, scenario: Scenario) -> str:
    """Return a line per frame and object."""
    lines = ["frame,object,x_m,y_m,z_m"]
    for time, frame in enumerate(positions):
        lines += [
            f"{time},{name},{x:.4f},{y:.4f},{z:.4f}"
            for name, (x, y, z), present in zip(scenario.colors, frame, presence, strict=True)
            if present
        ]
    return "\n".join(lines) + "\n"
