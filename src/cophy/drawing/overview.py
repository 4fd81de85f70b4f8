"""What look.py shows of a dataset: a contact sheet, and one experiment in time.

Twins: experiments that start alike and end differently, because what is hidden in them differs.
The three modalities of a frame, with their scales.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.atomic_files import write_atomically
from cophy.drawing.files import gif, write_picture
from cophy.drawing.labels import Line, Words, color_bar, text_block
from cophy.drawing.sheets import (
    DEPTH_COLORS,
    MIN_CELL_PX,
    CloseUp,
    Row,
    at,
    cell_px,
    depth_in_color,
    grid,
    labelled,
    render_sequence,
    resized,
    segmentation_in_color,
    side_by_side,
    under,
)
from cophy.scenario import Scenario
from cophy.scenario.rendering import NO_OBJECT, Renderer, RenderSettings


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
