"""Frames in rows and columns, with words, and as colours."""

import numpy as np

from cophy.config import settings
from cophy.drawing.sheets import DEPTH_COLORS, depth_in_color, grid, labelled, segmentation_in_color, side_by_side

RED, BLUE = (np.full((2, 2, 3), color, np.uint8) for color in ((255, 0, 0), (0, 0, 255)))


def test_a_grid_by_hand() -> None:
    joined = grid([[RED, BLUE], [BLUE, RED]])
    assert joined.shape == (8, 8, 3)
    assert joined[0, 0].tolist() == joined[7, 7].tolist() == [255, 0, 0]
    assert joined[3, 3].tolist() == [255, 255, 255]


def test_a_smaller_picture_lies_at_the_upper_left_of_its_cell() -> None:
    joined = grid([[RED, BLUE], [np.zeros((3, 5, 3), np.uint8)]])
    assert joined.shape == (2 + 4 + 3, 5 + 4 + 2, 3)
    assert joined[0, 1].tolist() == [255, 0, 0]
    assert joined[0, 2].tolist() == [255, 255, 255]
    assert joined[0, 9].tolist() == [0, 0, 255]


def test_rows_have_their_text_beside_them_and_headings_above() -> None:
    sheet = labelled(["0.0 s", "1.0 s"], [([], [RED, BLUE]), ([], [BLUE, RED])], 32)
    right, lower = sheet[:, -32:], sheet[-32:]
    assert (right[-32:] == (255, 0, 0)).all()
    assert (right[-68:-36] == (0, 0, 255)).all()
    assert (lower[:, -68:-36] == (0, 0, 255)).all()
    assert (lower[:, :-68] == 255).all()  # a row without text
    assert (sheet[:-68, -32:] < 255).any()  # the heading


def test_frames_of_a_clip_differ_in_their_time_alone_where_nothing_moves() -> None:
    clip = side_by_side({"one": np.stack([RED] * 2), "other": np.stack([BLUE] * 2)}, frame_rate_hz=5)
    changed = np.nonzero((clip[0] != clip[1]).any(axis=-1))
    assert clip.shape[0] == 2
    assert len(changed[0])
    assert changed[0].max() < clip.shape[1] - 224  # above the pictures


def test_near_is_bright_and_nothing_is_white() -> None:
    picture, ends = depth_in_color(np.array([[0, 1000], [2000, 3000]], np.uint16))
    assert picture[0, 0].tolist() == [255, 255, 255]
    assert picture[0, 1].tolist() == DEPTH_COLORS[0].tolist()
    assert picture[1, 1].tolist() == DEPTH_COLORS[-1].tolist()
    assert picture[0, 1].sum() > picture[1, 0].sum() > picture[1, 1].sum()
    assert ends == (1.0, 3.0)


def test_segmentation_has_the_colours_of_the_slots() -> None:
    scenario = settings("generate", "scenario=balls").scenario
    shown = segmentation_in_color(np.array([[0, 255]], np.uint8), scenario)
    assert "#" + bytes(shown[0, 0].tolist()).hex() == scenario.colors["red"]
    assert shown[0, 1].tolist() == [255, 255, 255]
