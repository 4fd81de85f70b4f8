"""Text as pictures."""

import numpy as np

from cophy.drawing.labels import Line, color_bar, text_block


def test_a_long_line_goes_on_below_and_no_word_is_cut() -> None:
    short, long = (text_block([Line(text)], 120) for text in ("a word", "several words that do not fit"))
    assert short.shape[1] == long.shape[1] == 120
    assert long.shape[0] > short.shape[0]
    assert (long[:, -2:] == 255).all()  # nothing reaches the end


def test_a_swatch_has_its_colour_and_stands_before_the_first_piece_alone() -> None:
    block = text_block([Line("words that need more than a line", swatch="#d1342f")], 120)
    red = np.nonzero((block == (0xD1, 0x34, 0x2F)).all(axis=-1))
    assert len(red[0]) > 20
    assert red[0].max() < 25


def test_bold_has_more_ink() -> None:
    plain, bold = (255 - text_block([Line("hidden", bold=bold)], 200).astype(int) for bold in (False, True))
    assert bold.sum() > 1.1 * plain.sum()


def test_a_color_bar_goes_from_the_first_colour_to_the_last() -> None:
    palette = np.linspace((255, 0, 0), (0, 0, 255), 256).astype(np.uint8)
    bar = color_bar(palette, (1.0, 2.0), "m", 300)
    assert bar.shape[1] == 300
    assert bar[12, 5].tolist() == [255, 0, 0]
    assert bar[12, -6].tolist() == [0, 0, 255]
    assert (bar[25:] < 255).any()  # what the colours stand for
