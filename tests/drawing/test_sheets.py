"""Frames in rows and columns, with text, colours and crops."""

from typing import Any

import matplotlib as mpl
import numpy as np

from cophy.config import settings
from cophy.dataset.images import render_sequence
from cophy.dataset.spec import DatasetSpec
from cophy.drawing.sheets import (
    DEPTH_COLORMAP,
    CloseUp,
    Line,
    color_bar,
    depth_colors,
    grid,
    labelled_rows,
    segmentation_colors,
    side_by_side,
    text_block,
    window_of_motion,
)
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Backend, Renderer, RenderSettings

RED, BLUE = (np.full((2, 2, 3), color, np.uint8) for color in ((255, 0, 0), (0, 0, 255)))
RENDER = RenderSettings(list(MODALITIES), 96, Backend.tiny)


def test_a_grid_of_two_by_two() -> None:
    joined = grid([[RED, BLUE], [BLUE, RED]])
    assert joined.shape == (8, 8, 3)
    assert joined[0, 0].tolist() == joined[7, 7].tolist() == [255, 0, 0]
    assert joined[3, 3].tolist() == [255, 255, 255]


def test_a_smaller_image_is_at_the_upper_left_of_its_cell() -> None:
    joined = grid([[RED, BLUE], [np.zeros((3, 5, 3), np.uint8)]])
    assert joined.shape == (2 + 4 + 3, 5 + 4 + 2, 3)
    assert joined[0, 1].tolist() == [255, 0, 0]
    assert joined[0, 2].tolist() == [255, 255, 255]
    assert joined[0, 9].tolist() == [0, 0, 255]


def test_rows_have_text_to_the_left_and_headings_above() -> None:
    sheet = labelled_rows(["0.0 s", "1.0 s"], [([], [RED, BLUE]), ([], [BLUE, RED])], 32)
    right, lower = sheet[:, -32:], sheet[-32:]
    assert (right[-32:] == (255, 0, 0)).all()
    assert (right[-68:-36] == (0, 0, 255)).all()
    assert (lower[:, -68:-36] == (0, 0, 255)).all()
    assert (lower[:, :-68] == 255).all()  # a row without text
    assert (sheet[:-68, -32:] < 255).any()  # the heading


def test_frames_of_a_static_clip_differ_only_in_their_time() -> None:
    clip = side_by_side({"one": np.stack([RED] * 2), "other": np.stack([BLUE] * 2)}, frame_rate_hz=5)
    changed = np.nonzero((clip[0] != clip[1]).any(axis=-1))
    assert clip.shape[0] == 2
    assert len(changed[0])
    assert changed[0].max() < clip.shape[1] - 224  # above the pictures


def test_near_surfaces_are_bright_and_missing_ones_white() -> None:
    def color(share: float) -> list[int]:
        return list(mpl.colormaps[DEPTH_COLORMAP](share, bytes=True)[:3])

    image, ends = depth_colors(np.array([[0, 1000], [2000, 3000]], np.uint16))
    assert image[0, 0].tolist() == [255, 255, 255]
    assert image[0, 1].tolist() == color(0.0)
    assert image[1, 1].tolist() == color(1.0)
    assert image[0, 1].sum() > image[1, 0].sum() > image[1, 1].sum()
    assert ends == (1.0, 3.0)


def test_segmentation_has_the_colours_of_the_slots() -> None:
    scenario = settings("generate", "scenario=balls").scenario
    shown = segmentation_colors(np.array([[0, 255]], np.uint8), scenario)
    assert "#" + bytes(shown[0, 0].tolist()).hex() == scenario.colors["red"]
    assert shown[0, 1].tolist() == [255, 255, 255]


def test_long_lines_are_wrapped_between_words() -> None:
    short, long = (text_block([Line(text)], 120) for text in ("a word", "several words that do not fit"))
    assert short.shape[1] == long.shape[1] == 120
    assert long.shape[0] > short.shape[0]
    assert (long[:, -2:] == 255).all()  # nothing reaches the end


def test_a_swatch_is_drawn_once_before_the_text() -> None:
    block = text_block([Line("words that need more than a line", swatch="#d1342f")], 120)
    red = np.nonzero((block == (0xD1, 0x34, 0x2F)).all(axis=-1))
    assert len(red[0]) > 20
    assert red[0].max() < 25


def test_bold_has_more_ink() -> None:
    plain, bold = (255 - text_block([Line("hidden", bold=bold)], 200).astype(int) for bold in (False, True))
    assert bold.sum() > 1.1 * plain.sum()


def test_a_color_bar_goes_from_the_first_colour_to_the_last() -> None:
    bar = color_bar("bwr", (1.0, 2.0), "m", 300)
    assert bar.shape == (55, 300, 3)
    assert bar[10, 12].astype(int) @ [-1, 0, 1] > 200  # blue
    assert bar[10, -13].astype(int) @ [1, 0, -1] > 200  # red
    assert (bar[25:] < 128).any()  # labels


def test_a_crop_contains_all_objects_and_is_filled_by_them(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    with Renderer(spec.scenario, RENDER.resolution) as renderer:
        whole = np.concatenate(
            [render_sequence(renderer, arrays, 2, sequence, slice(None)).segmentation for sequence in (0, 1)]
        )
    window = window_of_motion(spec.scenario, arrays, [2])
    cropped = window.cut(whole)
    assert cropped.shape[1] == cropped.shape[2] <= RENDER.resolution
    assert (cropped != NO_OBJECT).sum() == (whole != NO_OBJECT).sum()
    seen = (cropped != NO_OBJECT).any(axis=0)
    extent = max(np.ptp(np.flatnonzero(seen.any(axis=axis))) for axis in (0, 1))
    assert extent > 0.6 * cropped.shape[1]


def test_a_close_up_has_about_as_many_pixels_as_the_whole_image(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    for frames in CloseUp(spec.scenario, arrays, [2], RENDER).frames(2, [0, -1]):
        assert frames.rgb.shape[0] == 2
        assert 0.5 * RENDER.resolution < frames.rgb.shape[1] <= 1.1 * RENDER.resolution
        assert frames.rgb.shape[:3] == frames.depth.shape == frames.segmentation.shape
