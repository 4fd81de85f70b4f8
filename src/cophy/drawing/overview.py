"""What look.py shows of a dataset: a contact sheet, twins, modalities, and one experiment as strip, clip and frames."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.atomic_files import write_atomically
from cophy.dataset.images import render_sequence
from cophy.drawing.files import encode_gif, write_image
from cophy.drawing.sheets import (
    DEPTH_COLORMAP,
    MIN_CELL_PX,
    CloseUp,
    Line,
    Row,
    at,
    cell_px,
    color_bar,
    depth_colors,
    grid,
    labelled_rows,
    resize,
    segmentation_colors,
    side_by_side,
    text_block,
    with_caption,
)
from cophy.scenario import Camera, Scenario, Shape
from cophy.scenario.rendering import NO_OBJECT, Renderer, RenderSettings

NUM_STRIP_FRAMES = 6
SHAPE_NAMES = {Shape.BOX: "block", Shape.SPHERE: "ball", Shape.CYLINDER: "cylinder"}
CONFOUNDER_FORMATS = {"mass": "{:g}\u00a0kg", "friction": "friction\u00a0{:g}", "restitution": "restitution\u00a0{:g}"}
NO_BREAK = "\u00a0"  # a space at which lines do not break
MIN_COMPONENT = 0.005  # smaller components of displacements and gravity are not named


class Descriptions:
    """Descriptions of the experiments of a loaded dataset: do-operations and confounders."""

    def __init__(self, scenario: Scenario, arrays: dict[str, np.ndarray]) -> None:
        self.scenario, self.arrays = scenario, arrays
        grid = scenario.confounders
        self._hidden = [name for name in CONFOUNDER_FORMATS if len(getattr(grid, name)) > 1]
        self._gravity_is_hidden = max(len(grid.gravity_x), len(grid.gravity_y)) > 1

    @property
    def hidden(self) -> str:
        """Names of the confounders, as in "mass, friction and gravity"."""
        names = [*self._hidden, *(["gravity"] if self._gravity_is_hidden else [])]
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def object_name(self, experiment: int, slot: int) -> str:
        """Return the name of an object, as in "red block"."""
        return f"{list(self.scenario.colors)[slot]} {SHAPE_NAMES[Shape(self.arrays['shape'][experiment, slot])]}"

    def slots(self, experiment: int) -> list[int]:
        """Return the slots of A's objects, the highest object first."""
        present = np.flatnonzero(self.arrays["presence"][experiment, 0])
        height = self.arrays["states"][experiment, 0, 0, present, 2].round(2)
        return [int(slot) for slot in present[np.argsort(-height, kind="stable")]]

    def do_operation(self, experiment: int) -> str:
        """Describe the do-operation, as in "the red block moved 0.40 m to the left"."""
        slot = int(self.arrays["do_slot"][experiment])
        name = f"the {self.object_name(experiment, slot)}"
        if not self.arrays["presence"][experiment, 1, slot]:
            return f"{name} removed"
        components = _components(self.arrays["do_offset"][experiment], self.scenario.camera)
        return f"{name} moved " + " and ".join(
            f"{size:.2f}{NO_BREAK}m {direction}" for direction, size in components.items()
        )

    def confounders(self, experiment: int, bold: Collection[str] = ()) -> list[Line]:
        """Return a line for each object, and one for gravity where it is hidden; lines with a text in `bold` are bold."""
        lines = []
        for slot in self.slots(experiment):
            values = [CONFOUNDER_FORMATS[name].format(self.arrays[name][experiment, slot]) for name in self._hidden]
            color = list(self.scenario.colors.values())[slot]
            lines.append(Line(f"{self.object_name(experiment, slot)}: {', '.join(values)}", swatch=color))
        if self._gravity_is_hidden:
            components = _components(self.arrays["gravity"][experiment], self.scenario.camera)
            text = ", ".join(f"{size:g}{NO_BREAK}{direction}" for direction, size in components.items())
            lines.append(Line(f"gravity in m/s²: {text}"))
        return [Line(line.text, line.swatch, bold=line.text in bold) for line in lines]

    def differing(self, experiment: int, other: int) -> set[str]:
        """Return the texts of lines of confounders that two experiments do not share."""
        first, second = ({line.text for line in self.confounders(row)} for row in (experiment, other))
        return first ^ second


def _components(vector: np.ndarray, camera: Camera) -> dict[str, float]:
    """Return the nonzero components of a vector (3,) as seen by the camera: direction -> size."""
    ahead = np.subtract(camera.target, camera.eye)[:2]
    ahead = ahead / np.linalg.norm(ahead)
    right = np.array([ahead[1], -ahead[0]])
    directions = (("to the right", "to the left"), ("to the back", "to the front"), ("up", "down"))
    sizes = (float(vector[:2] @ right), float(vector[:2] @ ahead), float(vector[2]))
    return {
        signs[size < 0]: abs(size) for signs, size in zip(directions, sizes, strict=True) if abs(size) >= MIN_COMPONENT
    }


def render_twins(
    scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, pair: tuple[int, int]
) -> np.ndarray:
    """Render AB and CD of both twins, cropped to one window: (twin, sequence, frame of the strip, R, R, 3) uint8."""
    times = strip_times(scenario)
    close_up = CloseUp(scenario, arrays, pair, render)
    return np.stack([[frames.rgb for frames in close_up.frames(twin, times)] for twin in tqdm(pair, desc="twins")])


def write_twins(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, pair: tuple[int, int]
) -> None:
    """Write both twins' AB, one above the other, and below them both twins' CD, with the confounders of each."""
    descriptions = Descriptions(scenario, arrays)
    images, differing = render_twins(scenario, arrays, render, pair), descriptions.differing(*pair)
    labels = [
        [Line(f"twin {n}", bold=True), Line("hidden:"), *descriptions.confounders(twin, bold=differing)]
        for n, twin in enumerate(pair, start=1)
    ]
    times, rate = strip_times(scenario), scenario.clock.frame_rate_hz

    def both_twins(sequence: int, start: str, end: str) -> np.ndarray:
        headings = [at(time, rate) for time in times]
        headings[0], headings[-1] = f"{start}, {headings[0]}", f"{end}, {headings[-1]}"
        rows = [(label, list(frames[sequence])) for label, frames in zip(labels, images, strict=True)]
        return labelled_rows(headings, rows, cell_px(render.resolution))

    title = Line(f"{scenario.name}: the twins {pair[0]} and {pair[1]} start alike and end differently", bold=True)
    observed = [
        title,
        Line("Only the hidden confounders differ (bold)."),
        Line(""),
        Line("AB, observed: both start from the same A.", bold=True),
    ]
    counterfactual = [
        Line(""),
        Line(
            f"CD, counterfactual: both start from the same C, which is A with {descriptions.do_operation(pair[0])}.",
            bold=True,
        ),
        Line("C alone does not determine D. AB does: it shows the effect of the hidden confounders."),
    ]
    parts = [with_caption(observed, both_twins(0, "A", "B")), with_caption(counterfactual, both_twins(1, "C", "D"))]
    write_image(path, grid([[part] for part in parts]))


def write_modalities(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> None:
    """Write RGB, depth and segmentation of a frame of AB after a third of the time."""
    descriptions, time, size = (
        Descriptions(scenario, arrays),
        scenario.clock.num_frames // 3,
        max(MIN_CELL_PX, render.resolution),
    )
    frames = next(CloseUp(scenario, arrays, [experiment], render).frames(experiment, [time]))
    depth, ends = depth_colors(frames.depth[0])
    images = [frames.rgb[0], depth, segmentation_colors(frames.segmentation[0], scenario)]
    titles = [
        "rgb: what the camera sees",
        "depth: along the camera's axis, stored in mm",
        "segmentation: which object is visible",
    ]
    colors = list(scenario.colors.values())
    names = [
        Line(f"{descriptions.object_name(experiment, slot)}, stored as {slot}", swatch=colors[slot])
        for slot in descriptions.slots(experiment)
    ]
    nothing = Line(f"no object, stored as {NO_OBJECT}", swatch="#ffffff")
    no_depth = Line("no surface, stored as 0", swatch="#ffffff")
    depth_scale = np.concatenate([color_bar(DEPTH_COLORMAP, ends, "m", size), text_block([no_depth], size)])
    scales = [text_block([], size), depth_scale, text_block([*names, nothing], size)]
    sheet = grid(
        [
            [text_block([Line(title, bold=True)], size) for title in titles],
            [resize(image, size) for image in images],
            scales,
        ]
    )
    when = at(time, scenario.clock.frame_rate_hz)
    write_image(path, with_caption([Line(f"{scenario.name}, experiment {experiment}, AB at {when}", bold=True)], sheet))


def strip_times(scenario: Scenario) -> list[int]:
    """Return the frames of a strip, including the first and the last."""
    return [int(time) for time in np.linspace(0, scenario.clock.num_frames - 1, NUM_STRIP_FRAMES)]


def write_contact_sheet(
    path: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, num_shown: int
) -> int:
    """Write A, B, C and D of the first `num_shown` experiments, with do-operation and confounders.

    Returns:
        The number of experiments on the sheet.
    """
    experiments = range(min(num_shown, len(arrays["states"])))
    descriptions, rows = Descriptions(scenario, arrays), list[Row]()
    for row in tqdm(experiments, desc="contact sheet"):
        frames = CloseUp(scenario, arrays, [row], render).frames(row, [0, -1])
        rows.append((_describe(descriptions, row), [image for sequence in frames for image in sequence.rgb]))
    end = at(scenario.clock.num_frames - 1, scenario.clock.frame_rate_hz)
    headings = ["A: start, 0.0 s", f"B: end of AB, {end}", "C: changed start, 0.0 s", f"D: end of CD, {end}"]
    sheet = labelled_rows(headings, rows, cell_px(render.resolution))
    title = Line(f"{scenario.name}: the first {len(experiments)} experiments", bold=True)
    rule = (
        f"The do-operation changes A to C. No single image shows {descriptions.hidden}; they are the same in AB and CD."
    )
    write_image(path, with_caption([title, Line(rule)], sheet))
    return len(experiments)


def _describe(descriptions: Descriptions, experiment: int) -> list[Line]:
    """Describe an experiment: its index, do-operation and confounders."""
    return [
        Line(f"experiment {experiment}", bold=True),
        Line(f"do-operation: {descriptions.do_operation(experiment)}"),
        Line("hidden:"),
        *descriptions.confounders(experiment),
    ]


def write_experiment(
    directory: Path, scenario: Scenario, arrays: dict[str, np.ndarray], render: RenderSettings, experiment: int
) -> None:
    """Write a strip of AB above CD, and a clip of both."""
    descriptions, rate, times = Descriptions(scenario, arrays), scenario.clock.frame_rate_hz, strip_times(scenario)
    close_up = CloseUp(scenario, arrays, [experiment], render).frames(experiment, slice(None))
    observed, counterfactual = (frames.rgb for frames in tqdm(close_up, total=2, desc="strip and clip"))
    changed = descriptions.do_operation(experiment)
    rows: list[Row] = [
        ([Line("AB: observed", bold=True), Line("hidden:"), *descriptions.confounders(experiment)], observed[times]),
        (
            [Line("CD: counterfactual", bold=True), Line(f"do-operation: {changed}"), Line("hidden: as in AB")],
            counterfactual[times],
        ),
    ]
    headings = [at(time, rate) for time in times]
    headings[0], headings[-1] = f"A and C, {headings[0]}", f"B and D, {headings[-1]}"
    strip = labelled_rows(headings, rows, cell_px(render.resolution))
    write_image(
        directory / "strip.png", with_caption([Line(f"{scenario.name}, experiment {experiment}", bold=True)], strip)
    )
    clip = side_by_side({"AB: observed": observed, f"CD: {changed}": counterfactual}, frame_rate_hz=rate)
    write_atomically(directory / "clip.gif", encode_gif(clip, frames_per_second=rate))


def write_frames(directory: Path, renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int) -> None:
    """Write every frame as a file that predict.py reads, and the scene without objects."""
    for sequence, name in enumerate(tqdm(("AB", "CD"), desc="frames as files")):
        for earlier in (directory / name).glob("[0-9]*.png"):  # from a longer sequence or another scenario
            earlier.unlink()
        for time, frame in enumerate(render_sequence(renderer, arrays, experiment, sequence, slice(None)).rgb):
            write_image(directory / name / f"{time:02d}.png", frame)
    empty = arrays | {"presence": np.zeros_like(arrays["presence"])}
    write_image(directory / "background.png", render_sequence(renderer, empty, experiment, 0, [0]).rgb[0])
