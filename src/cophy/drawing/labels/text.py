"""Lines of text as pictures, in the font that matplotlib brings along."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

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
