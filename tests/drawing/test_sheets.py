"""Frames in rows and columns, and as colours."""

import numpy as np

from cophy.app.composition import settings
from cophy.drawing.sheets import depth_in_grey, grid, segmentation_in_color


def test_a_grid_by_hand() -> None:
    red, blue = (np.full((2, 2, 3), color, np.uint8) for color in ((255, 0, 0), (0, 0, 255)))
    joined = grid([[red, blue], [blue, red]])
    assert joined.shape == (8, 8, 3)
    assert joined[0, 0].tolist() == joined[7, 7].tolist() == [255, 0, 0]
    assert joined[3, 3].tolist() == [255, 255, 255]


def test_near_is_bright_and_nothing_is_black() -> None:
    grey = depth_in_grey(np.array([[0, 1000], [2000, 3000]], np.uint16))[..., 0]
    assert grey[0, 0] == 0
    assert grey[0, 1] > grey[1, 0] > grey[1, 1] > 0


def test_segmentation_has_the_colours_of_the_slots() -> None:
    scenario = settings("generate", "scenario=balls").scenario
    shown = segmentation_in_color(np.array([[0, 255]], np.uint8), scenario)
    assert "#" + bytes(shown[0, 0].tolist()).hex() == scenario.colors["red"]
    assert shown[0, 1].tolist() == [255, 255, 255]
