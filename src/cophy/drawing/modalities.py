"""The three modalities of a frame, with their scales."""

from pathlib import Path

import numpy as np

from cophy.drawing.close_up import CloseUp
from cophy.drawing.labels.color_bar import color_bar
from cophy.drawing.labels.text import Line, text_block
from cophy.drawing.labels.words import Words
from cophy.drawing.picture_files import write_picture
from cophy.drawing.sheets import (
    DEPTH_COLORS,
    MIN_CELL_PX,
    at,
    depth_in_color,
    grid,
    resized,
    segmentation_in_color,
    under,
)
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import NO_OBJECT, RenderSettings


def write_modalities(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> None:
    """RGB, depth and segmentation of a frame of AB after a third of the time.

    Args:
        path: The picture to write.
        scenario: Of the dataset.
        arrays: The dataset.
        render: Resolution and backend.
        experiment: Index of the experiment.
    """
    words, time, size = Words(scenario, arrays), scenario.clock.num_frames // 3, max(MIN_CELL_PX, render.resolution)
    frames = next(CloseUp(scenario, arrays, [experiment], render).frames(experiment, [time]))
    depth, ends = depth_in_color(frames.depth[0])
    pictures = [frames.rgb[0], depth, segmentation_in_color(frames.segmentation[0], scenario)]
    titles = [
        "rgb: what the camera sees",
        "depth: along the camera's axis, stored in mm",
        "segmentation: which object is seen",
    ]
    colors = list(scenario.colors.values())
    names = [
        Line(f"{words.object_name(experiment, slot)}, stored as {slot}", swatch=colors[slot])
        for slot in words.slots(experiment)
    ]
    nothing = Line(f"no object, stored as {NO_OBJECT}", swatch="#ffffff")
    no_depth = Line("no surface, stored as 0", swatch="#ffffff")
    depth_scale = np.concatenate([color_bar(DEPTH_COLORS, ends, "m", size), text_block([no_depth], size)])
    scales = [text_block([], size), depth_scale, text_block([*names, nothing], size)]
    shown = grid(
        [
            [text_block([Line(title, bold=True)], size) for title in titles],
            [resized(picture, size) for picture in pictures],
            scales,
        ]
    )
    when = at(time, scenario.clock.frame_rate_hz)
    write_picture(path, under([Line(f"{scenario.name}, experiment {experiment}, AB at {when}", bold=True)], shown))
