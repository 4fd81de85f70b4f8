"""Frames in rows and columns, with words beside them; depth and segmentation as colours.

Frames of a dataset: whole, and cropped to what moves.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import cv2
import matplotlib as mpl
import numpy as np
from PIL import ImageColor

from cophy.drawing.labels import Line, text_block
from cophy.scenario import Scenario
from cophy.scenario.camera import Window
from cophy.scenario.rendering import Frames, Renderer, RenderSettings

REACH = 3**0.5 / 2  # from the centre of a cube to its corner, in edges
MAX_ENLARGED = 2.0  # a small window is drawn with at most so many times the pixels along an edge


def render_sequence(
    renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int, sequence: int, times: slice | Sequence[int]
) -> Frames:
    """Frames of one sequence of a loaded dataset.

    Args:
        renderer: Of the dataset's scenario.
        arrays: The dataset.
        experiment: Index of the experiment.
        sequence: 0 for AB, 1 for CD.
        times: Which frames.
    """
    states = arrays["states"][experiment, sequence, :: renderer.scenario.clock.states_per_frame][times]
    return renderer.render(
        states[..., :3],
        states[..., 3:7],
        presence=arrays["presence"][experiment, sequence],
        shapes=arrays["shape"][experiment].tolist(),
        background_seed=int(arrays["background_seed"][experiment]),
    )


def window_of(scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int]) -> Window:
    """The part of the picture in which everything moves, in all frames of some experiments.

    Args:
        scenario: Of the dataset.
        arrays: The dataset.
        experiments: Their indices.
    """
    rows = list(experiments)
    places = arrays["states"][rows, :, :: scenario.clock.states_per_frame, :, :3]
    present = np.broadcast_to(arrays["presence"][rows][:, :, None], places.shape[:-1])
    return scenario.camera.window_around(places[present], REACH * scenario.object_size_m)


class CloseUp:
    """Frames of some experiments, all cropped alike, to the part of the picture in which something moves.

    What they show is what the stored pictures show; they are drawn with more pixels, so that the crop has as many.
    """

    def __init__(
        self, scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int], render: RenderSettings
    ) -> None:
        """Choose the part that is shown.

        Args:
            scenario: Of the dataset.
            arrays: The dataset.
            experiments: Indices of those that are to be seen.
            render: Resolution and backend; the modalities are all.
        """
        self._scenario, self._arrays, self._render = scenario, arrays, render
        self._window = window_of(scenario, arrays, experiments)

    def frames(self, experiment: int, times: slice | Sequence[int]) -> Iterator[Frames]:
        """Those of AB, and then of CD, of an experiment."""
        resolution = math.ceil(self._render.resolution * min(1 / self._window.edge, MAX_ENLARGED))
        with Renderer(self._scenario, resolution, self._render.backend) as renderer:
            for sequence in (0, 1):
                whole = render_sequence(renderer, self._arrays, experiment, sequence, times)
                yield Frames(*map(self._window.cut, whole))


GAP_PX = 4
MIN_CELL_PX = 224  # smaller pictures are enlarged: a label has to fit above
LABEL_PX = 330  # width of the text beside a row
WHITE = 255
DEPTH_COLORS = (255 * mpl.colormaps["viridis_r"](np.arange(256))[:, :3]).astype(np.uint8)  # near is bright

Row = tuple[Sequence[Line], Iterable[np.ndarray]]  # what stands to the left of pictures, and the pictures


def grid(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Pictures, (H, W, 3) uint8, in rows and columns with white gaps; smaller ones lie at the upper left of their cell."""
    heights = [max(picture.shape[0] for picture in row) for row in rows]
    widths = [max(row[n].shape[1] for row in rows if n < len(row)) for n in range(max(map(len, rows)))]
    size = sum(heights) + GAP_PX * (len(heights) - 1), sum(widths) + GAP_PX * (len(widths) - 1)
    sheet, top = np.full((*size, 3), WHITE, np.uint8), 0
    for row, height in zip(rows, heights, strict=True):
        left = 0
        for picture, width in zip(row, widths, strict=False):
            sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
            left += width + GAP_PX
        top += height + GAP_PX
    return sheet


def cell_px(resolution: int) -> int:
    """Edge of a picture on a sheet, of frames of this resolution."""
    return max(MIN_CELL_PX, resolution // 2)


def resized(picture: np.ndarray, size: int) -> np.ndarray:
    """A square picture, (R, R, 3) uint8, as large as `size`."""
    how = cv2.INTER_AREA if size < len(picture) else cv2.INTER_NEAREST
    return picture if size == len(picture) else cv2.resize(picture, (size, size), interpolation=how)


def labelled(headings: Sequence[str], rows: Sequence[Row], size: int) -> np.ndarray:
    """Rows of pictures under headings, each row with its text to the left.

    Args:
        headings: One for each column of pictures.
        rows: Text and pictures.
        size: Edge of the pictures, pixels.
    """
    top = [text_block([], LABEL_PX), *(text_block([Line(heading)], size) for heading in headings)]
    below = [
        [text_block(lines, LABEL_PX), *(resized(picture, size) for picture in pictures)] for lines, pictures in rows
    ]
    return grid([top, *below])


def under(lines: Sequence[Line], picture: np.ndarray) -> np.ndarray:
    """A picture with lines of text above."""
    return grid([[text_block(lines, picture.shape[1])], [picture]])


def side_by_side(sequences: dict[str, np.ndarray], *, frame_rate_hz: float) -> np.ndarray:
    """Sequences (T, R, R, 3) next to each other, each under its title and the time."""
    titles, frames = list(sequences), zip(*sequences.values(), strict=True)
    size = max(MIN_CELL_PX, *(sequence.shape[1] for sequence in sequences.values()))
    return np.stack(
        [
            grid(
                [
                    [text_block([Line(title), Line(at(time, frame_rate_hz))], size) for title in titles],
                    [resized(picture, size) for picture in pictures],
                ]
            )
            for time, pictures in enumerate(frames)
        ]
    )


def at(frame: int, frame_rate_hz: float) -> str:
    """The time of a frame, as in "1.2 s"."""
    return f"{frame / frame_rate_hz:.1f} s"


def segmentation_in_color(segmentation: np.ndarray, scenario: Scenario) -> np.ndarray:
    """(..., R, R) slots -> (..., R, R, 3) in the slots' colours, white where there is no object."""
    palette = np.full((256, 3), WHITE, np.uint8)
    palette[: scenario.num_slots] = [ImageColor.getrgb(color) for color in scenario.colors.values()]
    return palette[segmentation]


def depth_in_color(depth: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """(R, R) millimetres -> (R, R, 3), white where there is nothing; metres of the first and last colour of DEPTH_COLORS."""
    seen = depth > 0
    near, far = (float(depth[seen].min()), float(depth[seen].max())) if seen.any() else (0.0, 1.0)
    place = (len(DEPTH_COLORS) - 1) * (depth.astype(float) - near) / max(far - near, 1.0)
    picture = DEPTH_COLORS[np.clip(place, 0, len(DEPTH_COLORS) - 1).astype(int)]
    return np.where(seen[..., None], picture, np.uint8(WHITE)), (near / 1000, far / 1000)
