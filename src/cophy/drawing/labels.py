"""A scale of colours.

Lines of text as pictures, in the font that matplotlib brings along.
An experiment in words: its do-operation, and what is hidden in it.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cophy.scenario import Camera, Scenario, Shape

FONT_PX = 17
LINE_SPACING = 1.35  # from line to line, in heights of the font
MARGIN_PX = 5
INK, PAPER, EDGE = "#1c1f24", "white", "#8a8f98"


@dataclass(frozen=True)
class Line:
    """A line of text.

    Attributes:
        text: What it says.
        swatch: A colour, "#rrggbb", shown as a small square before the text.
        bold: Whether it stands out.
    """

    text: str
    swatch: str | None = None
    bold: bool = False


def text_block(lines: Sequence[Line], width: int) -> np.ndarray:
    """(H, width, 3) uint8: lines one below the other on white; a line that is too long goes on in the next.

    Args:
        lines: What is written.
        width: Of the picture, pixels.
    """
    rows = [row for line in lines for row in _wrapped(line, width - 2 * MARGIN_PX)]
    step = round(LINE_SPACING * FONT_PX)
    picture = Image.new("RGB", (width, step * max(1, len(rows)) + MARGIN_PX), PAPER)
    pen = ImageDraw.Draw(picture)
    for number, row in enumerate(rows):
        left, top = MARGIN_PX, number * step + MARGIN_PX // 2
        if row.swatch is not None:
            square = (left, top + 4, left + FONT_PX - 5, top + FONT_PX - 1)
            pen.rectangle(square, fill=row.swatch, outline=EDGE)
        pen.text((left + row.indent, top), row.text, fill=INK, font=font(FONT_PX, bold=row.bold))
    return np.asarray(picture)


@dataclass(frozen=True)
class _Row(Line):
    indent: int = 0  # pixels


def _wrapped(line: Line, width: int) -> Iterator[_Row]:
    """The line in pieces that fit; words stay whole, and the swatch stands before the first."""
    measure, indent = font(FONT_PX, bold=line.bold).getlength, 0 if line.swatch is None else FONT_PX + 1
    swatch, said = line.swatch, ""
    for word in line.text.split(" "):
        longer = f"{said} {word}" if said else word
        if said and measure(longer) > width - indent:
            yield _Row(said, swatch, line.bold, indent)
            swatch, said = None, word
        else:
            said = longer
    yield _Row(said, swatch, line.bold, indent)


@lru_cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font in a size, pixels."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), size)


NOUNS = {Shape.BOX: "block", Shape.SPHERE: "ball", Shape.CYLINDER: "cylinder"}
CONFOUNDERS = {"mass": "{:g}\u00a0kg", "friction": "friction\u00a0{:g}", "restitution": "restitution\u00a0{:g}"}
TOGETHER = "\u00a0"  # a space at which no line ends
SMALLEST = 0.005  # a part of a movement, or of gravity, below this is not named


class Words:
    """Words about the experiments of a loaded dataset."""

    def __init__(self, scenario: Scenario, arrays: dict[str, np.ndarray]) -> None:
        self.scenario, self.arrays = scenario, arrays
        grid = scenario.confounders
        self._hidden = [name for name in CONFOUNDERS if len(getattr(grid, name)) > 1]
        self._gravity_is_hidden = max(len(grid.gravity_x), len(grid.gravity_y)) > 1

    @property
    def hidden(self) -> str:
        """Names of the confounders, as in "mass, friction and gravity"."""
        names = [*self._hidden, *(["gravity"] if self._gravity_is_hidden else [])]
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def object_name(self, experiment: int, slot: int) -> str:
        """As in "red block"."""
        return f"{list(self.scenario.colors)[slot]} {NOUNS[Shape(self.arrays['shape'][experiment, slot])]}"

    def slots(self, experiment: int) -> list[int]:
        """The slots of A's objects, the highest object first."""
        present = np.flatnonzero(self.arrays["presence"][experiment, 0])
        height = self.arrays["states"][experiment, 0, 0, present, 2].round(2)
        return [int(slot) for slot in present[np.argsort(-height, kind="stable")]]

    def do_operation(self, experiment: int) -> str:
        """What makes C of A, as in "the red block moved 0.40 m to the left"."""
        slot = int(self.arrays["do_slot"][experiment])
        name = f"the {self.object_name(experiment, slot)}"
        if not self.arrays["presence"][experiment, 1, slot]:
            return f"{name} taken away"
        parts = _parts(self.arrays["do_offset"][experiment], self.scenario.camera)
        return f"{name} moved " + " and ".join(f"{size:.2f}{TOGETHER}m {way}" for way, size in parts.items())

    def confounders(self, experiment: int, bold: Collection[str] = ()) -> list[Line]:
        """A line for each object, and one for gravity where that is hidden.

        Args:
            experiment: Whose confounders.
            bold: Lines with one of these texts stand out.
        """
        lines = []
        for slot in self.slots(experiment):
            values = [CONFOUNDERS[name].format(self.arrays[name][experiment, slot]) for name in self._hidden]
            color = list(self.scenario.colors.values())[slot]
            lines.append(Line(f"{self.object_name(experiment, slot)}: {', '.join(values)}", swatch=color))
        if self._gravity_is_hidden:
            parts = _parts(self.arrays["gravity"][experiment], self.scenario.camera)
            said = ", ".join(f"{size:g}{TOGETHER}{way}" for way, size in parts.items())
            lines.append(Line(f"gravity in m/s²: {said}"))
        return [Line(line.text, line.swatch, bold=line.text in bold) for line in lines]

    def differing(self, experiment: int, other: int) -> set[str]:
        """Texts of the lines of confounders that two experiments do not share."""
        mine, others = ({line.text for line in self.confounders(row)} for row in (experiment, other))
        return mine ^ others


def _parts(vector: np.ndarray, camera: Camera) -> dict[str, float]:
    """The parts of a vector, (3,), as the camera's viewer names them: direction -> size, those that are not zero."""
    ahead = np.subtract(camera.target, camera.eye)[:2]
    ahead = ahead / np.linalg.norm(ahead)
    right = np.array([ahead[1], -ahead[0]])
    ways = (("to the right", "to the left"), ("to the back", "to the front"), ("up", "down"))
    sizes = (float(vector[:2] @ right), float(vector[:2] @ ahead), float(vector[2]))
    return {way[size < 0]: abs(size) for way, size in zip(ways, sizes, strict=True) if abs(size) >= SMALLEST}


BAR_PX = 14
NUM_TICKS = 5


def color_bar(palette: np.ndarray, ends: tuple[float, float], unit: str, width: int) -> np.ndarray:
    """(H, width, 3) uint8: the palette from left to right, and what its colours stand for below it.

    Args:
        palette: (N, 3) uint8 colours.
        ends: What the first and the last colour stand for.
        unit: Of these.
        width: Of the picture, pixels.
    """
    picture = Image.new("RGB", (width, BAR_PX + 2 * FONT_PX + 2 * MARGIN_PX), PAPER)
    pen, length = ImageDraw.Draw(picture), width - 2 * MARGIN_PX
    bar = palette[np.linspace(0, len(palette) - 1, length).round().astype(int)]
    picture.paste(Image.fromarray(np.repeat(bar[None], BAR_PX, axis=0)), (MARGIN_PX, MARGIN_PX))
    under = MARGIN_PX + BAR_PX
    for tick in range(NUM_TICKS):
        share = tick / (NUM_TICKS - 1)
        x = MARGIN_PX + share * (length - 1)
        pen.line([(x, under), (x, under + 4)], fill=INK)
        place = "l" if tick == 0 else "r" if tick == NUM_TICKS - 1 else "m"
        said = f"{ends[0] + share * (ends[1] - ends[0]):.1f}" + (f" {unit}" if tick == NUM_TICKS - 1 else "")
        pen.text((x, under + 5), said, fill=INK, font=font(FONT_PX), anchor=f"{place}a")
    return np.asarray(picture)
