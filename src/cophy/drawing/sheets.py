"""Frames in rows and columns with text next to them, as arrays: (H, W, 3) uint8.

Text is drawn by Pillow and not by matplotlib, because a GIF has a sheet per frame.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image, ImageColor, ImageDraw, ImageFont

from cophy.dataset.images import render_sequence
from cophy.scenario import Scenario
from cophy.scenario.camera import Window
from cophy.scenario.rendering import Frames, Renderer, RenderSettings

FONT_PX = 17
LINE_SPACING = 1.35  # in heights of the font
MARGIN_PX = 5
INK, PAPER, EDGE = "#1c1f24", "white", "#8a8f98"
GAP_PX = 4
MIN_CELL_PX = 224  # smaller images are enlarged, so that a label fits above
TEXT_PX = 330  # width of the text next to a row
WHITE = 255
DEPTH_COLORMAP = "viridis_r"  # near is bright
REACH = 3**0.5 / 2  # distance from the centre of a cube to its corner, in edges
MAX_ENLARGED = 2.0  # a small window is rendered with at most this many times the pixels along an edge


@dataclass(frozen=True)
class Line:
    """A line of text, with a colour "#rrggbb" that is shown as a small square before it."""

    text: str
    swatch: str | None = None
    bold: bool = False


Row = tuple[Sequence[Line], Iterable[np.ndarray]]  # text to the left of images, and the images


def text_block(lines: Sequence[Line], width: int) -> np.ndarray:
    """Return lines of text on white, (H, width, 3) uint8; long lines are wrapped."""
    rows = [row for line in lines for row in _wrap(line, width - 2 * MARGIN_PX)]
    step = round(LINE_SPACING * FONT_PX)
    image = Image.new("RGB", (width, step * max(1, len(rows)) + MARGIN_PX), PAPER)
    draw = ImageDraw.Draw(image)
    for number, (text, swatch, line) in enumerate(rows):
        left, top = MARGIN_PX, number * step + MARGIN_PX // 2
        if swatch is not None:
            square = (left, top + 4, left + FONT_PX - 5, top + FONT_PX - 1)
            draw.rectangle(square, fill=swatch, outline=EDGE)
        draw.text((left + _indent_px(line), top), text, fill=INK, font=_font(bold=line.bold))
    return np.asarray(image)


def _wrap(line: Line, width: int) -> Iterator[tuple[str, str | None, Line]]:
    """Yield the parts of a line that fit into a width, without breaking words; only the first has the swatch."""
    measure, swatch, text = _font(bold=line.bold).getlength, line.swatch, ""
    for word in line.text.split(" "):
        longer = f"{text} {word}" if text else word
        if text and measure(longer) > width - _indent_px(line):
            yield text, swatch, line
            swatch, text = None, word
        else:
            text = longer
    yield text, swatch, line


def _indent_px(line: Line) -> int:
    return 0 if line.swatch is None else FONT_PX + 1


@lru_cache
def _font(*, bold: bool) -> ImageFont.FreeTypeFont:
    """Load the font that matplotlib comes with."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), FONT_PX)


def grid(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Join images in rows and columns with white gaps; smaller ones are at the upper left of their cell."""
    heights = [max(image.shape[0] for image in row) for row in rows]
    widths = [max(row[n].shape[1] for row in rows if n < len(row)) for n in range(max(map(len, rows)))]
    size = sum(heights) + GAP_PX * (len(heights) - 1), sum(widths) + GAP_PX * (len(widths) - 1)
    sheet, top = np.full((*size, 3), WHITE, np.uint8), 0
    for row, height in zip(rows, heights, strict=True):
        left = 0
        for image, width in zip(row, widths, strict=False):
            sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
            left += width + GAP_PX
        top += height + GAP_PX
    return sheet


def cell_px(resolution: int) -> int:
    """Return the edge of an image on a sheet, for frames of this resolution."""
    return max(MIN_CELL_PX, resolution // 2)


def resize(image: np.ndarray, size: int) -> np.ndarray:
    """Resize a square image, (R, R, 3) uint8."""
    interpolation = cv2.INTER_AREA if size < len(image) else cv2.INTER_NEAREST
    return image if size == len(image) else cv2.resize(image, (size, size), interpolation=interpolation)


def labelled_rows(headings: Sequence[str], rows: Sequence[Row], size: int) -> np.ndarray:
    """Join rows of images under headings, each row with its text to the left. size: edge of the images, pixels."""
    header = [text_block([], TEXT_PX), *(text_block([Line(heading)], size) for heading in headings)]
    body = [[text_block(lines, TEXT_PX), *(resize(image, size) for image in images)] for lines, images in rows]
    return grid([header, *body])


def with_caption(lines: Sequence[Line], image: np.ndarray) -> np.ndarray:
    """Return an image with lines of text above."""
    return grid([[text_block(lines, image.shape[1])], [image]])


def side_by_side(sequences: dict[str, np.ndarray], *, frame_rate_hz: float) -> np.ndarray:
    """Join sequences (T, R, R, 3) horizontally, each under its title and the time."""
    titles, frames = list(sequences), zip(*sequences.values(), strict=True)
    size = max(MIN_CELL_PX, *(sequence.shape[1] for sequence in sequences.values()))
    return np.stack(
        [
            grid(
                [
                    [text_block([Line(title), Line(at(time, frame_rate_hz))], size) for title in titles],
                    [resize(image, size) for image in images],
                ]
            )
            for time, images in enumerate(frames)
        ]
    )


def at(frame: int, frame_rate_hz: float) -> str:
    """Format the time of a frame, as in "1.2 s"."""
    return f"{frame / frame_rate_hz:.1f} s"


def segmentation_colors(segmentation: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Colour slots (..., R, R) -> (..., R, R, 3), white where there is no object."""
    palette = np.full((256, 3), WHITE, np.uint8)
    palette[: scenario.num_slots] = [ImageColor.getrgb(color) for color in scenario.colors.values()]
    return palette[segmentation]


def depth_colors(depth: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Colour depth (R, R) in millimetres -> (R, R, 3), white where there is no surface; also return its range in metres."""
    seen = depth > 0
    near, far = (float(depth[seen].min()), float(depth[seen].max())) if seen.any() else (0.0, 1.0)
    share = np.clip((depth.astype(float) - near) / max(far - near, 1.0), 0, 1)
    image = mpl.colormaps[DEPTH_COLORMAP](share, bytes=True)[..., :3]
    return np.where(seen[..., None], image, np.uint8(WHITE)), (near / 1000, far / 1000)


def color_bar(colormap: str, ends: tuple[float, float], unit: str, width: int) -> np.ndarray:
    """Draw a horizontal scale of colours from `ends[0]` to `ends[1]`, (H, width, 3) uint8."""
    figure = Figure(figsize=(width / 100, 0.55), dpi=100)
    axis = figure.add_axes((0.03, 0.65, 0.94, 0.3))
    mappable = ScalarMappable(Normalize(*ends), colormap)
    figure.colorbar(mappable, cax=axis, orientation="horizontal", format=f"%.1f {unit}").ax.locator_params(nbins=5)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def window_of_motion(scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int]) -> Window:
    """Return the part of the image that contains all objects in all frames of some experiments."""
    rows = list(experiments)
    positions = arrays["states"][rows, :, :: scenario.clock.states_per_frame, :, :3]
    present = np.broadcast_to(arrays["presence"][rows][:, :, None], positions.shape[:-1])
    return scenario.camera.window_around(positions[present], REACH * scenario.object_size_m)


class CloseUp:
    """Frames of some experiments, all cropped to the part of the image in which something moves.

    They show what the stored images show, rendered with more pixels, so that the crop has as many as these.
    """

    def __init__(
        self, scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int], render: RenderSettings
    ) -> None:
        self._scenario, self._arrays, self._render = scenario, arrays, render
        self._window = window_of_motion(scenario, arrays, experiments)

    def frames(self, experiment: int, times: slice | Sequence[int]) -> Iterator[Frames]:
        """Yield all modalities of AB, and then of CD, of an experiment."""
        resolution = math.ceil(self._render.resolution * min(1 / self._window.edge, MAX_ENLARGED))
        with Renderer(self._scenario, resolution, self._render.backend) as renderer:
            for sequence in (0, 1):
                whole = render_sequence(renderer, self._arrays, experiment, sequence, times)
                yield Frames(*map(self._window.cut, whole))
