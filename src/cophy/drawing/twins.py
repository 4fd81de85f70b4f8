"""Twins: experiments that start alike and end differently, because what is hidden in them differs."""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.drawing.close_up import CloseUp
from cophy.drawing.labels.text import Line
from cophy.drawing.labels.words import Words
from cophy.drawing.overview import strip_times
from cophy.drawing.picture_files import write_picture
from cophy.drawing.sheets import at, cell_px, grid, labelled, under
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import RenderSettings


def twins_of(experiment: int) -> tuple[int, int]:
    """The experiment and its twin, in the dataset's order."""
    first = experiment - experiment % 2
    return first, first + 1


def render_twins(
    scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> np.ndarray:
    """(twin, sequence, frame of the strip, R, R, 3) uint8: AB and CD of both twins, all cropped alike.

    Args:
        scenario: Of the dataset.
        arrays: The dataset.
        render: Resolution and backend.
        experiment: Index of either twin.
    """
    pair, times = twins_of(experiment), strip_times(scenario)
    close_up = CloseUp(scenario, arrays, pair, render)
    return np.stack([[frames.rgb for frames in close_up.frames(twin, times)] for twin in tqdm(pair, desc="twins")])


def write_twins(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> None:
    """Both twins' AB one above the other, and below them both twins' CD, with what is hidden in each.

    Args:
        path: The picture to write.
        scenario: Of the dataset.
        arrays: The dataset.
        render: Resolution and backend.
        experiment: Index of either twin.
    """
    pair, words = twins_of(experiment), Words(scenario, arrays)
    drawn, differing = render_twins(scenario, arrays, render, experiment), words.differing(*pair)
    labels = [
        [Line(f"twin {n}", bold=True), Line("hidden:"), *words.confounders(twin, bold=differing)]
        for n, twin in enumerate(pair, start=1)
    ]
    times, rate = strip_times(scenario), scenario.clock.frame_rate_hz

    def of_both(sequence: int, start: str, end: str) -> np.ndarray:
        headings = [at(time, rate) for time in times]
        headings[0], headings[-1] = f"{start}, {headings[0]}", f"{end}, {headings[-1]}"
        rows = [(label, list(frames[sequence])) for label, frames in zip(labels, drawn, strict=True)]
        return labelled(headings, rows, cell_px(render.resolution))

    title = Line(f"{scenario.name}: the twins {pair[0]} and {pair[1]} start alike and end differently", bold=True)
    observed = [
        title,
        Line("Only what is hidden differs (bold)."),
        Line(""),
        Line("AB, observed: both start from the same A.", bold=True),
    ]
    counterfactual = [
        Line(""),
        Line(
            f"CD, counterfactual: both start from the same C, which is A with {words.do_operation(pair[0])}.", bold=True
        ),
        Line("C alone does not tell which D comes. AB does: it shows the effect of what is hidden."),
    ]
    parts = [under(observed, of_both(0, "A", "B")), under(counterfactual, of_both(1, "C", "D"))]
    write_picture(path, grid([[part] for part in parts]))
