"""What predict.py writes: predicted positions as a table, a clip and a strip of AB, the truth and the prediction."""

from pathlib import Path

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.drawing.files import gif, write_picture
from cophy.drawing.labels import NOUNS, Line
from cophy.drawing.overview import strip_times
from cophy.drawing.sheets import Row, at, cell_px, labelled, side_by_side, under
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.camera import Window
from cophy.scenario.rendering import NO_OBJECT, Renderer

PREDICTED = "CD: predicted"
UPRIGHT_XYZW = (0.0, 0.0, 0.0, 1.0)
PLAIN = 225  # brightness where the background is not known
CHANGED = 24  # a pixel this much brighter or darker than the background shows an object or its shadow
MARGIN = 0.04  # around what changes, as a share of the picture


def render_positions(
    positions: np.ndarray, presence: np.ndarray, scenario: Scenario, background: np.ndarray
) -> np.ndarray:
    """Frames of which only positions are known: shapes are the scenario's guess, and nothing is turned.

    Args:
        positions: (T, K, 3) metres.
        presence: (K,) which slots hold an object.
        scenario: Whose objects and camera to draw with.
        background: (R, R, 3) uint8, the scene without objects. Objects and their shadows are drawn over it.

    Returns:
        (T, R, R, 3) uint8.
    """
    upright = np.broadcast_to(UPRIGHT_XYZW, (*positions.shape[:2], 4))
    shapes = [int(scenario.shape_from_positions)] * scenario.num_slots
    nothing = np.zeros_like(presence)
    with Renderer(scenario, len(background)) as renderer:
        empty = renderer.render(positions[:1], upright[:1], presence=nothing, shapes=shapes, background_seed=0).rgb
        drawn = renderer.render(positions, upright, presence=presence, shapes=shapes, background_seed=0)
    brightness = np.minimum(drawn.rgb / np.maximum(empty, 1.0), 1.0)  # less than 1 in shadows
    shaded = np.rint(background * brightness).astype(np.uint8)
    return np.where(drawn.segmentation[..., None] == NO_OBJECT, shaded, drawn.rgb)


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
        directory: Where they go.
        positions: (T, K, 3) metres, C and then D as predicted.
        presence: (K,) which slots hold an object.
        scenario: Whose objects and camera to draw with.
        observed: (T, R, R, 3) uint8 frames of AB.
        truth: The same of the true CD, where it is known.
        background: (R, R, 3) uint8, the scene without objects, where it is known. The pictures are cropped to what differs
            from it.

    Raises:
        CophyError: The true frames are not as many or as large as those of AB, or the background is not as large.
    """
    if truth is not None and truth.shape != observed.shape:
        raise CophyError(f"truth has {truth.shape[:3]} frames, rows and columns, AB has {observed.shape[:3]}")
    if background is not None and background.shape != observed.shape[1:]:
        raise CophyError(f"background has {background.shape[:2]} rows and columns, AB has {observed.shape[1:3]}")
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / "positions.csv", _as_csv(positions, presence, scenario).encode())
    behind = np.full_like(observed[0], PLAIN) if background is None else background
    sequences = {"AB: observed": observed} | ({} if truth is None else {"CD: what truly happens": truth})
    sequences[PREDICTED] = render_positions(positions, presence, scenario, behind)
    if background is not None:
        window = window_of_changes(np.concatenate(list(sequences.values())), background)
        sequences = {name: window.cut(frames) for name, frames in sequences.items()}
    rate, times = scenario.clock.frame_rate_hz, strip_times(scenario)
    clip = side_by_side(sequences, frame_rate_hz=rate)
    write_atomically(directory / "prediction.gif", gif(clip, frames_per_second=rate))
    rows: list[Row] = [
        (_label(name, scenario, background is not None), frames[times]) for name, frames in sequences.items()
    ]
    strip = labelled([at(time, rate) for time in times], rows, cell_px(observed.shape[1]))
    title = Line(f"{scenario.name}: what would have happened, had the start been C?", bold=True)
    write_picture(directory / "strip.png", under([title], strip))


def window_of_changes(frames: np.ndarray, background: np.ndarray) -> Window:
    """The smallest square part, with a margin, in which frames (T, R, R, 3) differ from the background (R, R, 3)."""
    size = len(background)
    changed = (np.abs(frames.astype(np.int16) - background).max(axis=-1) > CHANGED).any(axis=0)
    if not changed.any():
        return Window(0.0, 0.0, 1.0)
    places = np.argwhere(changed)[:, ::-1] / size
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + 1 / size + MARGIN
    edge = min(1.0, float((high - low).max()))
    left, top = np.clip((low + high - edge) / 2, 0, 1 - edge).tolist()
    return Window(left, top, edge)


def _label(name: str, scenario: Scenario, background_is_known: bool) -> list[Line]:
    """What stands beside a sequence."""
    said = [Line(name, bold=True)]
    if name == PREDICTED:
        noun = NOUNS[scenario.shape_from_positions]
        said.append(Line("From the pictures of AB and C alone."))
        said.append(Line(f"Only positions are predicted: every object is drawn as a {noun}, not turned."))
        said += [] if background_is_known else [Line("Grey: the background is not known (background=).")]
    return said


def _as_csv(positions: np.ndarray, presence: np.ndarray, scenario: Scenario) -> str:
    """A line per frame and object."""
    lines = ["frame,object,x_m,y_m,z_m"]
    for time, places in enumerate(positions):
        lines += [
            f"{time},{name},{x:.4f},{y:.4f},{z:.4f}"
            for name, (x, y, z), present in zip(scenario.colors, places, presence, strict=True)
            if present
        ]
    return "\n".join(lines) + "\n"
