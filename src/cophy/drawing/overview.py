"""What look.py shows of a dataset: a contact sheet, and one experiment in time."""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.atomic_files import write_atomically
from cophy.drawing.close_up import CloseUp, render_sequence
from cophy.drawing.gifs import gif
from cophy.drawing.labels.text import Line
from cophy.drawing.labels.words import Words
from cophy.drawing.picture_files import write_picture
from cophy.drawing.sheets import Row, at, cell_px, labelled, side_by_side, under
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import RenderSettings
from cophy.scenario.rendering.renderer import Renderer

NUM_STRIP_FRAMES = 6


def strip_times(scenario: Scenario) -> list[int]:
    """The frames of a strip, the first and the last among them."""
    return [int(time) for time in np.linspace(0, scenario.clock.num_frames - 1, NUM_STRIP_FRAMES)]


def write_contact_sheet(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, num_shown: int
) -> int:
    """A, B, C and D of some experiments, of every twin pair the first, with what is done and hidden in them.

    Args:
        path: The picture to write.
        scenario: Of the dataset.
        arrays: The dataset.
        render: Resolution and backend.
        num_shown: How many experiments, or as many as there are.

    Returns:
        How many are shown.
    """
    shown = range(0, min(2 * num_shown, len(arrays["states"])), 2)
    words, rows = Words(scenario, arrays), list[Row]()
    for row in tqdm(shown, desc="contact sheet"):
        frames = CloseUp(scenario, arrays, [row], render).frames(row, [0, -1])
        rows.append((_about(words, row), [picture for sequence in frames for picture in sequence.rgb]))
    end = at(scenario.clock.num_frames - 1, scenario.clock.frame_rate_hz)
    headings = ["A: start, 0.0 s", f"B: end of AB, {end}", "C: changed start, 0.0 s", f"D: end of CD, {end}"]
    sheet = labelled(headings, rows, cell_px(render.resolution))
    title = Line(f"{scenario.name}: the first of each of {len(shown)} pairs of twins", bold=True)
    rule = f"The do-operation changes A to C. No single picture shows {words.hidden}; they are the same in AB and CD."
    write_picture(path, under([title, Line(rule)], sheet))
    return len(shown)


def _about(words: Words, experiment: int) -> list[Line]:
    """Which experiment it is, what makes C of A, and what is hidden."""
    return [
        Line(f"experiment {experiment}", bold=True),
        Line(f"do-operation: {words.do_operation(experiment)}"),
        Line("hidden:"),
        *words.confounders(experiment),
    ]


def write_experiment(
    directory: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> None:
    """A strip of AB over CD, and a clip.

    Args:
        directory: Where they go.
        scenario: Of the dataset.
        arrays: The dataset.
        render: Resolution and backend.
        experiment: Index of the experiment.
    """
    words, rate, times = Words(scenario, arrays), scenario.clock.frame_rate_hz, strip_times(scenario)
    close_up = CloseUp(scenario, arrays, [experiment], render).frames(experiment, slice(None))
    observed, counterfactual = (frames.rgb for frames in tqdm(close_up, total=2, desc="strip and clip"))
    changed = words.do_operation(experiment)
    rows: list[Row] = [
        ([Line("AB: observed", bold=True), Line("hidden:"), *words.confounders(experiment)], observed[times]),
        (
            [Line("CD: counterfactual", bold=True), Line(f"do-operation: {changed}"), Line("hidden: as in AB")],
            counterfactual[times],
        ),
    ]
    headings = [at(time, rate) for time in times]
    headings[0], headings[-1] = f"A and C, {headings[0]}", f"B and D, {headings[-1]}"
    strip = labelled(headings, rows, cell_px(render.resolution))
    write_picture(directory / "strip.png", under([Line(f"{scenario.name}, experiment {experiment}", bold=True)], strip))
    clip = side_by_side({"AB: observed": observed, f"CD: {changed}": counterfactual}, frame_rate_hz=rate)
    write_atomically(directory / "clip.gif", gif(clip, frames_per_second=rate))


def write_frames(directory: Path, renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int) -> None:
    """Every frame as a file that predict.py takes, whole, and the scene without objects.

    Args:
        directory: Where they go.
        renderer: Of the dataset's scenario.
        arrays: The dataset.
        experiment: Index of the experiment.
    """
    for sequence, name in enumerate(tqdm(("AB", "CD"), desc="frames as files")):
        for earlier in (directory / name).glob("[0-9]*.png"):  # of a longer sequence, or another scenario
            earlier.unlink()
        for time, frame in enumerate(render_sequence(renderer, arrays, experiment, sequence, slice(None)).rgb):
            write_picture(directory / name / f"{time:02d}.png", frame)
    empty = arrays | {"presence": np.zeros_like(arrays["presence"])}
    write_picture(directory / "background.png", render_sequence(renderer, empty, experiment, 0, [0]).rgb[0])
