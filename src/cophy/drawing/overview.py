"""What look.py shows of a dataset: a contact sheet, and one experiment in time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.atomic_files import write_atomically
from cophy.drawing.gifs import gif
from cophy.drawing.picture_files import write_picture
from cophy.drawing.sheets import depth_in_grey, grid, segmentation_in_color, side_by_side
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import Frames
from cophy.scenario.rendering.renderer import Renderer

NUM_STRIP_FRAMES = 6
TITLES = ("observed AB", "counterfactual CD")


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


def write_contact_sheet(path: Path, renderer: Renderer, arrays: dict[str, np.ndarray], num_shown: int) -> int:
    """A, B, C and D of some experiments, of every twin pair the first.

    Args:
        path: The picture to write.
        renderer: Of the dataset's scenario.
        arrays: The dataset.
        num_shown: How many experiments, or as many as there are.

    Returns:
        How many are shown.
    """
    shown = range(0, min(2 * num_shown, len(arrays["states"])), 2)
    rows = [
        [frame for s in (0, 1) for frame in render_sequence(renderer, arrays, row, s, [0, -1]).rgb]
        for row in tqdm(shown, desc="contact sheet")
    ]
    write_picture(path, grid(rows))
    return len(shown)


def write_experiment(directory: Path, renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int) -> None:
    """A strip of AB over CD, the three modalities, a clip, and every frame as a file that predict.py takes.

    Args:
        directory: Where they go.
        renderer: Of the dataset's scenario.
        arrays: The dataset.
        experiment: Index of the experiment.
    """
    scenario = renderer.scenario
    observed, counterfactual = (
        render_sequence(renderer, arrays, experiment, sequence, slice(None))
        for sequence in tqdm((0, 1), desc="experiment")
    )
    times = np.linspace(0, scenario.clock.num_frames - 1, NUM_STRIP_FRAMES).astype(int)
    write_picture(directory / "strip.png", grid([observed.rgb[times], counterfactual.rgb[times]]))
    write_picture(directory / "modalities.png", grid([_modalities(observed, scenario)]))
    clip = side_by_side(dict(zip(TITLES, (observed.rgb, counterfactual.rgb), strict=True)))
    write_atomically(directory / "clip.gif", gif(clip, frames_per_second=scenario.clock.frame_rate_hz))
    for name, frames in (("AB", observed.rgb), ("CD", counterfactual.rgb)):
        for time, frame in enumerate(frames):
            write_picture(directory / name / f"{time:02d}.png", frame)


def _modalities(frames: Frames, scenario: Scenario) -> list[np.ndarray]:
    """RGB, depth and segmentation of a frame after a third of the time."""
    time = scenario.clock.num_frames // 3
    depth, segmentation = depth_in_grey(frames.depth[time]), segmentation_in_color(frames.segmentation[time], scenario)
    return [frames.rgb[time], depth, segmentation]
