"""A scale of colours."""

import numpy as np
from PIL import Image, ImageDraw

from cophy.drawing.labels.text import FONT_PX, INK, MARGIN_PX, PAPER, font

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
